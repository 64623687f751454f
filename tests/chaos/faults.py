"""The faults, by the rows of DESIGN 10's table. Each is made and undone again; how episodes take it is seen outside."""

from __future__ import annotations

import os
import random
import resource
import signal
import sqlite3
import time
from collections.abc import Callable, Collection
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from orchestrator.core.supervise import ServiceProcess
from tests.chaos.arena import SPECS, Arena
from tests.chaos.stack import ChaoticStack

BURST = 24
NAN_PLANS = 15
"""So many that one of three episodes has five in a row, which end it."""


@dataclass
class Scene:
    """Where faults are made."""

    stack: ChaoticStack
    arena: Arena
    draw: random.Random
    data_dir: Path

    def process(self, name: str) -> ServiceProcess:
        """One of the four."""
        return next(each for each in self.stack.processes() if each.name == name)


Act = Callable[[Scene], None]


@dataclass(frozen=True)
class Fault:
    """A fault.

    Attributes:
        row: of the fault table.
        make: makes it, holds it for a while and undoes it; returns when the part concerned is whole again.
    """

    name: str
    row: str
    make: Act


def _kill(name: str) -> Act:
    def make(scene: Scene) -> None:
        process = scene.process(name)
        old = process.pid
        os.kill(old, signal.SIGKILL)
        # The keeper starts another one, at the same address; its line says when it serves.
        scene.arena.wait(lambda: scene.process(name).pid not in (0, old), f"{name} is started again")
        scene.arena.wait(lambda: scene.stack.ready(name), f"{name} is ready")

    return make


def _freeze(name: str, least_s: float, most_s: float) -> Act:
    def make(scene: Scene) -> None:
        pid = scene.process(name).pid
        os.kill(pid, signal.SIGSTOP)
        try:
            time.sleep(scene.draw.uniform(least_s, most_s))
        finally:
            os.kill(pid, signal.SIGCONT)

    return make


def _meddle(link: str, faults: tuple[str, ...], share: float, seconds: float) -> Act:
    def make(scene: Scene) -> None:
        proxy = scene.stack.links[link]
        proxy.faults, proxy.share = faults, share
        try:
            time.sleep(seconds)
        finally:
            proxy.share = 0.0

    return make


def _spoil(kind: str, plans: int) -> Act:
    def make(scene: Scene) -> None:
        scene.stack.order(kind, plans)
        # What came of it later would be taken for the next fault's.
        scene.arena.wait(lambda: scene.arena.ask_for_plans() and scene.stack.carried_out(), f"{plans} plans are {kind}")

    return make


def _full_disk(scene: Scene) -> None:
    """No byte can be written to any file, as far as the orchestrator is concerned."""
    pid = scene.process("orchestrator").pid
    _, most = resource.prlimit(pid, resource.RLIMIT_FSIZE)
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (0, most))
    try:
        time.sleep(scene.draw.uniform(1.5, 3.0))
    finally:
        resource.prlimit(pid, resource.RLIMIT_FSIZE, (most, most))


def _locked_store(scene: Scene) -> None:
    with closing(sqlite3.connect(scene.data_dir / "motionloop.sqlite", isolation_level=None, timeout=30.0)) as other:
        other.execute("BEGIN EXCLUSIVE")
        try:
            time.sleep(scene.draw.uniform(1.5, 3.0))
        finally:
            other.execute("ROLLBACK")


def _lie(scene: Scene) -> None:
    """A planner that does not keep to what it has declared is not let in, and what was there stays."""
    before = scene.arena.ask("GET", "/v1/services")
    scene.stack.order("other_rate", 10_000)
    answer = scene.arena.ask("PUT", "/v1/services/planner", {"plugin": "stand"})
    scene.stack.order("none", 0)
    assert answer is None or answer.status_code >= 400, f"a lying planner was let in: {answer.text}"
    after = scene.arena.ask("GET", "/v1/services")
    if before is not None and after is not None:
        assert before.json()["planner"] == after.json()["planner"], "the slot has changed"


def _flood(scene: Scene) -> None:
    """More episodes than there is room for, at once."""
    taken, refused = [], 0
    for _ in range(BURST):
        answer = scene.arena.ask("POST", "/v1/episodes", SPECS[0])  # none of them ends by itself meanwhile
        if answer is None:
            continue
        if answer.status_code == 201:
            taken.append(answer.json()["id"])
        else:
            assert answer.status_code in (429, 503), answer.text
            assert int(answer.headers["retry-after"]) >= 1
            refused += 1
    assert refused, "nothing was refused"
    for path in [f"/v1/episodes/{episode_id}" for episode_id in taken]:
        scene.arena.wait(lambda path=path: scene.arena.ask("DELETE", path) is not None, "it is cancelled")


FAULTS: tuple[Fault, ...] = (
    Fault("planner killed", "planner", _kill("planner")),
    Fault("planner frozen", "planner", _freeze("planner", 3.0, 6.0)),
    Fault("planner cut off", "planner", _meddle("planner", ("drop",), 1.0, 4.0)),
    Fault("tracker killed", "tracker", _kill("tracker")),
    Fault("second tracker killed", "tracker", _kill("spare")),
    Fault("tracker frozen", "tracker", _freeze("tracker", 2.0, 6.0)),
    Fault("orchestrator killed", "orchestrator", _kill("orchestrator")),
    Fault("orchestrator frozen", "orchestrator", _freeze("orchestrator", 0.5, 2.0)),
    *(
        Fault(f"{link}: {fault}", "messages", _meddle(link, (fault,), 0.2, 1.5))
        for link in ("planner", "tracker")
        for fault in ("drop", "delay", "double", "reorder", "corrupt")
    ),
    Fault("disk full", "disk and store", _full_disk),
    Fault("store locked", "disk and store", _locked_store),
    Fault("two plans of NaN", "NaN and lies", _spoil("nan", 2)),
    Fault("plans of NaN", "NaN and lies", _spoil("nan", NAN_PLANS)),
    Fault("a plan far away", "NaN and lies", _spoil("far", 1)),
    Fault("a plan raises", "NaN and lies", _spoil("raise", 1)),
    Fault("plans of another rate", "NaN and lies", _spoil("other_rate", 3)),
    Fault("plans that start late", "NaN and lies", _spoil("late_start", 3)),
    Fault("a planner that lies", "NaN and lies", _lie),
    Fault("flood of episodes", "overload", _flood),
)
PLANNER_ONLY = ("planner",)
"""Rows in which physics by the clock must go on all the time."""


def shuffled(count: int, seed: int, rows: Collection[str] | None = None) -> list[Fault]:
    """So many faults, of these rows or of all, in seeded random order; every one comes before any comes twice.

    Raises ValueError where there are none.
    """
    draw = random.Random(seed)
    wanted = [fault for fault in FAULTS if rows is None or fault.row in rows]
    if not wanted:
        raise ValueError(f"no faults of {rows}: there are {sorted({fault.row for fault in FAULTS})}")
    out: list[Fault] = []
    while len(out) < count:
        round_ = list(wanted)
        draw.shuffle(round_)
        out += round_
    return out[:count]
