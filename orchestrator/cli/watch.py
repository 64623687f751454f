"""`motionloop watch`: a running character in the terminal."""

from __future__ import annotations

import json
import time
from collections import deque
from contextlib import suppress
from typing import Any, TextIO

import numpy as np
from rich.console import Console, Group
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from orchestrator.cli.braille import side_view, top_view
from orchestrator.client import Character, CharacterInfo, Event, PlanGhost, State
from shared.errors import DeadlineError
from shared.protocol.rates import TICK_HZ

DRAWN_HZ = 10.0
LOOK_S = 1.0
WIDE_COLUMNS = 116
"""From here on the facts fit beside the pictures."""
PATH_POINTS = 120
COLOURS = {"running": "green", "paused": "cyan", "degraded": "yellow", "failed": "red", "closed": "red"}


class View:
    """What is known of a character, and how it is shown."""

    def __init__(self, info: CharacterInfo):
        self.info = info
        self.state = info.now()
        self._path: deque[np.ndarray] = deque(maxlen=PATH_POINTS)
        self._said: deque[str] = deque(maxlen=4)
        self._plan_ms: deque[float] = deque(maxlen=20)
        self._first = (self.state.tick, time.monotonic())

    def take(self, message: State | PlanGhost | Event) -> None:
        """Take in what came from the stream."""
        if isinstance(message, State):
            self.state = message
            if message.tick % 3 == 0:
                self._path.append(message.pelvis_w_m[:2])
        elif isinstance(message, Event):
            if message.type == "plan":
                self._plan_ms.append(float(message.data.get("total_ms", 0.0)))
            else:
                self._said.append(f"{message.tick / TICK_HZ:7.1f} s  {message.type} {_short(message.data)}")

    def render(self, columns: int = 120) -> Group:
        """The whole view, for a terminal of so many columns."""
        state = self.state
        target = self.info.command.get("target")
        goal = np.array(target["position_m"][:2]) if target else None
        side = Text("\n".join(side_view(state.positions_w_m, state.heading_rad)))
        top = Text("\n".join(top_view(state.positions_w_m, self._path, goal)))
        events = Text("\n".join(self._said), style="dim", no_wrap=True)
        views = [Panel(side, title="side", expand=False), Panel(top, title="top, 6 m", expand=False)]
        facts = Panel(self._facts(), title="state", expand=False)
        row = Table.grid()
        if columns >= WIDE_COLUMNS:
            row.add_row(*views, facts)
            return Group(row, events)
        row.add_row(*views)
        return Group(row, facts, events)

    def _facts(self) -> Table:
        state, info = self.state, self.info
        command = info.command.get("text") or "-"
        target = info.command.get("target")
        health = Text(info.status, style=COLOURS.get(info.status, "white"))
        if info.reason:
            health.append(f": {info.reason}")
        rows: list[tuple[str, str | Text]] = [
            ("character", info.id[:8]),
            ("status", Text("fallen", style="red") if state.fallen else health),
            ("told", command),
            ("target", f"{target['joint']} {tuple(target['position_m'])}" if target else "-"),
            ("time", f"{state.time_s:.1f} s (tick {state.tick})"),
            ("clock", self._clock()),
            ("pelvis", "({:+.2f}, {:+.2f}, {:.2f}) m".format(*state.pelvis_w_m)),
            ("heading", f"{np.degrees(state.heading_rad):+.0f} deg"),
            ("tracking error", f"{1000 * state.tracking_error_m:.0f} mm"),
            ("plan latency", self._latency()),
            ("plan ends in", f"{(state.plan_end_tick - state.tick) / TICK_HZ:+.1f} s"),
            ("missed ticks", str(state.missed_ticks)),
            ("planner, tracker", f"{info.planner or 'default'}, {state.tracker}"),
        ]
        facts = Table.grid(padding=(0, 1))
        for name, value in rows:
            facts.add_row(Text(name, style="dim"), value)
        return facts

    def _clock(self) -> str:
        if self.info.pacing != "realtime":
            return self.info.pacing
        tick, since = self._first
        seconds = time.monotonic() - since
        return "realtime" if seconds < 1.0 else f"realtime x {(self.state.tick - tick) / TICK_HZ / seconds:.2f}"

    def _latency(self) -> str:
        if not self._plan_ms:
            return "-"
        return f"{self._plan_ms[-1]:.0f} ms (worst of {len(self._plan_ms)}: {max(self._plan_ms):.0f})"


def watch(character: Character, console: Console, seconds: float | None, lines: TextIO | None = None) -> View:
    """Show a character until it ends, Ctrl-C, or for some seconds; returns what was seen last.

    Args:
        lines: where each state is written as a line of JSON, or None.
    """
    view = View(character.info())
    began = time.monotonic()
    drawn = looked = began
    with (
        Live(view.render(console.width), console=console, auto_refresh=False) as live,
        suppress(KeyboardInterrupt, DeadlineError),  # a character that stands still says nothing
    ):
        for message in character.watch(timeout_s=seconds, past_events=3):
            view.take(message)
            if lines is not None and isinstance(message, State):
                lines.write(json.dumps(_record(message)) + "\n")
            now = time.monotonic()
            if now - looked > LOOK_S:
                view.info, looked = character.info(), now
            if now - drawn > 1.0 / DRAWN_HZ:
                live.update(view.render(console.width), refresh=True)
                drawn = now
            if seconds is not None and now - began > seconds:
                break
        live.update(view.render(console.width), refresh=True)
    return view


def _record(state: State) -> dict[str, Any]:
    return {
        "tick": state.tick,
        "time_s": state.time_s,
        "pelvis_m": [round(float(v), 4) for v in state.pelvis_w_m],
        "heading_rad": state.heading_rad,
        "tracking_error_m": state.tracking_error_m,
        "fallen": state.fallen,
        "missed_ticks": state.missed_ticks,
    }


def _short(data: dict[str, Any]) -> str:
    return ", ".join(f"{name} {value}" for name, value in data.items() if not isinstance(value, dict | list))[:80]
