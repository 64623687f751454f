"""`motionloop top`: services, characters and running episodes in one live table."""

from __future__ import annotations

import json
import time
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from typing import Annotated, Any, TextIO

import typer
from rich.console import Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from orchestrator.cli.common import JsonFile, Token, Url, client, console
from orchestrator.client import CharacterInfo, Client, EpisodeInfo
from orchestrator.client.calls import DEFAULT_URL
from orchestrator.rest import ServiceHealth, ServicesHealth
from shared.protocol.rates import TICK_HZ

SHOWN = 40
"""Rows of characters and of episodes; more are counted only."""
COLOURS = {
    "ok": "green", "running": "green", "acting": "green", "paused": "cyan", "degraded": "yellow", "away": "red",
    "failed": "red", "fallen": "red",
}  # fmt: skip


@dataclass(frozen=True)
class Look:
    """What a server says of itself at one moment."""

    services: ServicesHealth
    characters: list[CharacterInfo]
    episodes: list[EpisodeInfo]

    @classmethod
    def at(cls, http: Client) -> Look:
        """Ask the server."""
        return cls(http.health(), http.characters.all(), http.episodes.all("running", SHOWN))

    def as_json(self) -> dict[str, Any]:
        """For files: the same without the characters' joints."""
        left_out = {"state": {"joints", "positions_m", "rotations_wxyz"}}
        return {
            "unix_s": time.time(),
            "services": self.services.model_dump(mode="json"),
            "characters": [c.model_dump(mode="json", exclude=left_out) for c in self.characters],
            "episodes": [e.model_dump(mode="json", exclude={"spec", "services"}) for e in self.episodes],
        }

    def render(self) -> Group:
        """As tables."""
        return Group(_services(self.services), _characters(self.characters), _episodes(self.episodes))


def _state(word: str) -> Text:
    return Text(word, style=COLOURS.get(word, "white"))


def _table(title: str, *columns: str) -> Table:
    out = Table(title=title, title_justify="left", expand=False)
    for column in columns:
        out.add_column(column, no_wrap=True)
    return out


def _services(health: ServicesHealth) -> Table:
    out = _table("services", "service", "state", "plug-in", "answers in", "up", "now")
    for name, service in (("planner", health.planner), ("tracker", health.tracker)):
        latency = "-" if service.latency_ms is None else f"{service.latency_ms:.1f} ms"
        up = "-" if service.uptime_s is None else f"{service.uptime_s:.0f} s"
        now = _planner_now(service) if name == "planner" else _tracker_now(service)
        out.add_row(name, _state(service.status), service.plugin, latency, up, service.message or now)
    return out


def _planner_now(service: ServiceHealth) -> str:
    detail, name = service.detail, service.plugin
    if f"{name}.plan_ms" not in detail:
        return f"no plan yet, {detail.get('pending', 0)} waiting"
    plans, batches = float(detail[f"{name}.plans"]), float(detail[f"{name}.batches"])
    return (
        f"plan {detail[f'{name}.plan_ms']} ms (p95 {detail[f'{name}.plan_ms_p95']}), queue p95 "
        f"{detail[f'{name}.queue_ms_p95']} ms, {plans:.0f} plans, {plans / max(batches, 1):.1f} a batch, "
        f"{detail['pending']} waiting"
    )


def _tracker_now(service: ServiceHealth) -> str:
    detail = service.detail
    return (
        f"{detail.get('characters', 0)} characters, tick {detail.get('tick_ms', 0)} ms (p95 "
        f"{detail.get('tick_ms_p95', 0)}), {detail.get('missed_ticks', 0)} missed, {detail.get('falls', 0)} falls, "
        f"{detail.get('stalls', 0)} stalls"
    )


def _characters(found: list[CharacterInfo]) -> Table:
    columns = ("id", "state", "pacing", "told", "time", "error", "plans", "plan ends in", "missed")
    out = _table(f"characters: {len(found)}", *columns)
    for info in found[:SHOWN]:
        state = info.state
        ends = f"{(state.plan_end_tick - state.tick) / TICK_HZ:+.1f} s"
        out.add_row(
            info.id[:8], _state("fallen" if state.fallen else info.status), info.pacing,
            str(info.command.get("text") or "-")[:32], f"{state.time_s:.1f} s",
            f"{1000 * state.tracking_error_m:.0f} mm", str(info.plans), ends, str(state.missed_ticks),
        )  # fmt: skip
    return out


def _episodes(found: list[EpisodeInfo]) -> Table:
    out = _table(f"running episodes: {len(found)}", "id", "phase", "time", "tasks done")
    for info in found:
        out.add_row(
            info.id[:8], _state(info.phase or info.status), f"{(info.tick or 0) / TICK_HZ:.1f} s",
            f"{len(info.results)} of {len(info.spec.get('tasks', []))}",
        )  # fmt: skip
    return out


def top(
    every: Annotated[float, typer.Option(min=0.2, max=60, help="seconds between two looks")] = 1.0,
    seconds: Annotated[float | None, typer.Option(min=0, help="end after so long; 0 looks once")] = None,
    json_file: JsonFile = None,
    url: Url = DEFAULT_URL,
    token: Token = None,
) -> None:
    """Show the services, characters and episodes of a server, until Ctrl-C. --json writes a line for each look."""
    with (
        client(url, token) as http,
        json_file.open("w", encoding="utf-8") if json_file else nullcontext() as lines,
        suppress(KeyboardInterrupt),
    ):
        _show(http, every, seconds, lines)


def _show(http: Client, every_s: float, seconds: float | None, lines: TextIO | None) -> None:
    look = Look.at(http)
    began = time.monotonic()
    with Live(look.render(), console=console, auto_refresh=False) as live:
        while True:
            if lines is not None:
                lines.write(json.dumps(look.as_json()) + "\n")
                lines.flush()
            if seconds is not None and time.monotonic() - began >= seconds:
                return
            time.sleep(every_s)
            look = Look.at(http)
            live.update(look.render(), refresh=True)
