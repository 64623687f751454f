"""Episodes on the terminal: live progress and the table at the end."""

from __future__ import annotations

from collections.abc import Callable

from rich.console import Console
from rich.table import Table

from orchestrator.client import EpisodeInfo, Event
from orchestrator.rest import CommandReading
from shared.protocol.rates import TICK_HZ


class Follower:
    """Says what happens in an episode: one live line of progress, and lines that stay for what matters."""

    def __init__(self, console: Console):
        self._console = console
        self._status = console.status("starting ...")
        self._task = ""

    def __enter__(self) -> Follower:
        self._status.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._status.stop()

    def take(self, event: Event) -> None:
        """Show one event."""
        data = event.data
        seconds = event.tick / TICK_HZ
        if event.type == "task_begin":
            self._task = str(data["label"])
            self._console.print(f"[dim]{seconds:6.1f} s[/dim]  {self._task}")
        elif event.type == "task_end":
            mark = "[green]ok[/green]" if data["success_strict"] else f"[red]{data['reason']}[/red]"
            self._console.print(f"[dim]{seconds:6.1f} s[/dim]    {mark} after {data['seconds']:.1f} s")
        elif event.type == "progress":
            place = f"at ({data['x_m']:+.2f}, {data['y_m']:+.2f}) m"
            error = f"tracking error {1000 * data['tracking_error_m']:.0f} mm"
            self._status.update(f"{seconds:6.1f} s  {self._task}: {place}, {error}")
        elif event.type in _SAID:
            self._console.print(f"[dim]{seconds:6.1f} s[/dim]    {_SAID[event.type](data)}", highlight=False)


def _reason(words: str) -> Callable[[dict[str, object]], str]:
    return lambda data: f"[yellow]{words}[/yellow]: {data.get('reason')}"


_SAID: dict[str, Callable[[dict[str, object]], str]] = {
    "planner_lost": _reason("the planner is away"),
    "planner_back": lambda data: "[green]the planner is back[/green]",
    "recording_failed": _reason("recording failed"),
    "recording_behind": _reason("the recording stays behind"),
    "reset": lambda data: "[yellow]stood up again[/yellow]",
    "swap": lambda data: f"{data.get('service')} is now {data.get('plugin')}",
    "end": lambda data: f"[bold]{data.get('status')}[/bold]" + (f": {data['reason']}" if data.get("reason") else ""),
}


def table(episode: EpisodeInfo) -> Table:
    """One row a task."""
    out = Table(title=f"episode {episode.status}")
    for column, justify in (("task", "left"), ("strict", "center"), ("seconds", "right"), ("measured", "left")):
        out.add_column(column, justify=justify)  # type: ignore[arg-type]
    for result in episode.results:
        measured = ", ".join(f"{name} {value:.2f}" for name, value in result.measures.items())
        strict = "[green]yes[/green]" if result.success_strict else f"[red]no[/red] ({result.reason})"
        out.add_row(result.name, strict, f"{result.seconds:.1f}", measured)
    return out


def notes(reading: CommandReading) -> list[str]:
    """Lines on how a command was taken, where it was not taken as it was given."""
    out = []
    if reading.dropped or len(reading.steps) > 1:
        left_out = f" (left out: {'; '.join(reading.dropped)})" if reading.dropped else ""
        out.append(f"understood as: {reading.understood}{left_out}")
    if reading.nearest is not None:
        near = reading.nearest
        out.append(f"far from all it was trained on; nearest: {near.text!r} ({near.similarity:.2f} of 1)")
    if reading.ignored_conditions:
        out.append(f"this planner ignores: {', '.join(reading.ignored_conditions)}")
    if reading.unreachable_joints:
        out.append(f"this planner has no targets for: {', '.join(reading.unreachable_joints)}")
    return out
