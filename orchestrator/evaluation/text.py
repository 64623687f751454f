"""`eval text`: a new command every few seconds; is each obeyed, and how often does the character fall?"""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import Callable
from typing import Any

import numpy as np

from orchestrator.core.agenda import task_seed
from orchestrator.core.character import CharacterSpec
from orchestrator.core.command import Command, CommandGoal
from orchestrator.core.events import EventLog
from orchestrator.core.services import Services
from orchestrator.core.session import Session
from orchestrator.core.settings import LOCKSTEP, LoopSettings
from shared.protocol.messages import TICK_HZ
from shared.statistics import wilson
from shared.tasks.interface import Trace, joined
from shared.tasks.obey import kind_of, obeyed
from shared.tasks.rules import with_falls

COMMANDS: dict[str, tuple[str, ...]] = {
    "walk": (
        "a person walks forward.",
        "a person is walking.",
        "walk forward",
        "someone strolls ahead at an easy pace.",
    ),
    "run": ("a person runs forward.", "a person is jogging.", "run", "someone sprints ahead."),
    "turn": ("a person turns left.", "a person turns to the right.", "turn around", "a person turns on the spot."),
    "wave": ("a person waves with the right hand.", "a person waves with the left hand.", "wave", "someone is waving."),
    "jump": ("a person jumps.", "a person jumps up in place.", "jump", "someone hops upward with both feet."),
    "stand": ("a person is standing still.", "stand still", "a person stops and stands.", "someone stands and waits."),
}


async def evaluate_text(
    services: Services,
    minutes: float,
    seed: int,
    every_s: float = 5.0,
    parallel: int = 4,
    planner: str | None = None,
    tracker: str | None = None,
    settings: LoopSettings = LOCKSTEP,
    progress: Callable[[int, int, dict[str, Any]], None] | None = None,
) -> dict[str, Any]:
    """Obedience over `minutes` of simulated time, shared between `parallel` characters.

    Returns:
        {commands, obeyed, ci95, by_kind: {kind: {n, obeyed}}, falls, falls_per_10min, rows}.
    """
    total = max(1, round(minutes * 60 / every_s))
    parallel = min(parallel, total)
    shares = [total // parallel + (1 if i < total % parallel else 0) for i in range(parallel)]
    rows: list[dict[str, Any]] = []

    def note(row: dict[str, Any]) -> None:
        rows.append(row)
        if progress is not None:
            progress(len(rows), total, row)

    async with asyncio.TaskGroup() as group:
        for stream, share in enumerate(shares):
            own = task_seed(seed, stream)
            group.create_task(_stream(services, stream, share, own, every_s, planner, tracker, settings, note))
    return _report(rows, minutes)


def choose_commands(count: int, seed: int) -> list[str]:
    """Sentences of all kinds in equal shares, never the same kind twice in a row where that can be had."""
    rng = np.random.default_rng(seed)
    out: list[str] = []
    deck: list[str] = []
    last = ""
    for _ in range(count):
        if not deck:
            deck = list(rng.permutation(list(COMMANDS)))
        kind = next((k for k in deck if k != last), deck[0])
        deck.remove(kind)
        out.append(str(rng.choice(COMMANDS[kind])))
        last = kind
    return out


async def _stream(
    services: Services, stream: int, count: int, seed: int, every_s: float, planner: str | None, tracker: str | None,
    settings: LoopSettings, note: Callable[[dict[str, Any]], None],
) -> None:  # fmt: skip
    spec = CharacterSpec(pacing="lockstep", seed=seed, planner=planner, tracker=tracker, loop=settings)
    session = Session(str(uuid.uuid4()), spec, services, EventLog())
    state = await session.start()
    for index, text in enumerate(choose_commands(count, seed)):
        begin = state.tick
        end = begin + round(every_s * TICK_HZ)
        goal = CommandGoal(Command(text=text), begin)
        session.replan_now()
        fell = False
        seen: list[Trace] = []
        while state.tick < end and not fell:
            cycle = await session.cycle(goal, end - state.tick)
            state = cycle.state
            seen.append(cycle.trace)
            done = with_falls(joined(seen))
            fell = bool(state.fallen) or bool(done.fallen.any())
        outcome = obeyed(text, done)
        note(
            {
                "stream": stream,
                "index": index,
                "tick": begin,
                "text": text,
                "kind": kind_of(text),
                "obeyed": outcome.obeyed and not fell,
                "fell": fell,
                "measures": outcome.measures,
            }
        )
        if fell:
            await session.reset()
            while state.tick < end + TICK_HZ:
                state = (await session.cycle(CommandGoal(Command(text="stand still"), state.tick), 15)).state
    await session.close()


def _report(rows: list[dict[str, Any]], minutes: float) -> dict[str, Any]:
    kept = sum(row["obeyed"] for row in rows)
    falls = sum(row["fell"] for row in rows)
    low, high = wilson(kept, len(rows))
    by_kind = {}
    for kind in COMMANDS:
        of_kind = [row for row in rows if row["kind"] == kind]
        if of_kind:
            by_kind[kind] = {"n": len(of_kind), "obeyed": sum(row["obeyed"] for row in of_kind) / len(of_kind)}
    return {
        "commands": len(rows),
        "obeyed": kept / len(rows),
        "ci95": [round(low, 4), round(high, 4)],
        "by_kind": by_kind,
        "falls": falls,
        "falls_per_10min": falls / minutes * 10,
        "rows": sorted(rows, key=lambda row: (row["stream"], row["index"])),
    }
