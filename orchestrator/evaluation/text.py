"""`eval text`: a new command every few seconds; is each obeyed, and how often does the character fall?"""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from orchestrator.core.agenda import task_seed
from orchestrator.core.character import CharacterSpec
from orchestrator.core.command import Command
from orchestrator.core.events import EventLog
from orchestrator.core.services import Services
from orchestrator.core.session import Session
from orchestrator.core.settings import LOCKSTEP, LoopSettings
from orchestrator.core.steps import SteppedGoal
from orchestrator.evaluation.commands import Asked, KindsOption, Outcome, choose, judged, shares
from shared.protocol.messages import TICK_HZ, StateFrame
from shared.statistics import wilson
from shared.tasks.interface import Trace, joined
from shared.tasks.kinds import LOW_KINDS
from shared.tasks.rules import leaning

GET_UP_S = 4.0


@dataclass(frozen=True)
class TextPlan:
    """What is asked for.

    Attributes:
        minutes: simulated time, shared between the characters; a list of sentences takes as long as it takes.
        every_s: a new command every so many seconds.
        kinds: which built-in commands.
        sentences: in their place, each once.
        record: folder for a .npz of what was done under each command.
    """

    minutes: float = 10.0
    every_s: float = 5.0
    kinds: KindsOption = "default"
    sentences: tuple[Asked, ...] = ()
    record: Path | None = None

    def streams(self, parallel: int, seed: int) -> list[list[Asked]]:
        """The commands of each of at most `parallel` characters."""
        if self.sentences:
            return shares(self.sentences, min(parallel, len(self.sentences)), seed)
        total = max(1, round(self.minutes * 60 / self.every_s))
        parallel = min(parallel, total)
        counts = [total // parallel + (1 if i < total % parallel else 0) for i in range(parallel)]
        return [choose(count, task_seed(seed, stream), self.kinds) for stream, count in enumerate(counts)]


async def evaluate_text(
    services: Services,
    plan: TextPlan,
    seed: int,
    parallel: int = 4,
    planner: str | None = None,
    tracker: str | None = None,
    settings: LoopSettings = LOCKSTEP,
    progress: Callable[[int, int, dict[str, Any]], None] | None = None,
) -> dict[str, Any]:
    """Obedience to commands given one after the other to a few characters.

    Returns:
        {commands, obeyed, ci95, by_kind: {kind: {n, obeyed}}, falls, falls_per_10min, rows}.
    """
    streams = plan.streams(parallel, seed)
    total = sum(len(stream) for stream in streams)
    rows: list[dict[str, Any]] = []

    def note(row: dict[str, Any]) -> None:
        rows.append(row)
        if progress is not None:
            progress(len(rows), total, row)

    async with asyncio.TaskGroup() as group:
        for number, asked in enumerate(streams):
            spec = CharacterSpec(
                pacing="lockstep", seed=task_seed(seed, number), planner=planner, tracker=tracker, loop=settings
            )
            group.create_task(_stream(services, number, asked, spec, plan, note))
    return _report(rows, total * plan.every_s / 60)


async def _stream(
    services: Services, stream: int, commands: list[Asked], spec: CharacterSpec, plan: TextPlan,
    note: Callable[[dict[str, Any]], None],
) -> None:  # fmt: skip
    session = Session(str(uuid.uuid4()), spec, services, EventLog())
    state = await session.start()
    for index, asked in enumerate(commands):
        begin = state.tick
        end = begin + round(plan.every_s * TICK_HZ)
        goal = SteppedGoal(Command(text=asked.text), begin)
        session.replan_now()
        seen: list[Trace] = []
        outcome, down = Outcome(False, False, {}), False
        while state.tick < end and not outcome.fell and not down:
            cycle = await session.cycle(goal, end - state.tick)
            state = cycle.state
            seen.append(cycle.trace)
            outcome, down = judged(asked, joined(seen)), bool(state.fallen)
        fell = outcome.fell or down
        if plan.record is not None:
            _record(plan.record, f"{stream:02d}_{index:04d}", asked, joined(seen))
        note(
            {
                "stream": stream,
                "index": index,
                "tick": begin,
                "text": asked.text,
                "kind": asked.group,
                "obeyed": outcome.obeyed and not fell,
                "fell": fell,
                "measures": outcome.measures,
            }
        )
        if asked.rule in LOW_KINDS and not fell:
            # Whoever has gone down gets up on a command of its own, so that the next one begins on the feet.
            session.replan_now()
            text = "a person gets up from the floor." if leaning(state.body_pos_w_m) else "stand still"
            state = await _go_on(session, text, state.tick + round(GET_UP_S * TICK_HZ))
        if fell or (asked.rule in LOW_KINDS and leaning(state.body_pos_w_m)):
            state = await session.reset()
            state = await _go_on(session, "stand still", max(state.tick, end) + TICK_HZ)
    await session.close()


async def _go_on(session: Session, text: str, until_tick: int) -> StateFrame:
    """What is done between commands, and judged by nobody."""
    state = session.state
    while state.tick < until_tick:
        state = (await session.cycle(SteppedGoal(Command(text=text), state.tick), 15)).state
    return state


def _record(folder: Path, name: str, asked: Asked, trace: Trace) -> None:
    """As `eval planner --recorded` reads it."""
    folder.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(
        folder / f"{name}.npz",
        body_pos_w_m=trace.pos_w_m.astype(np.float32),
        fps=np.array(float(TICK_HZ)),
        text=np.array(asked.text),
        kind=np.array(asked.group),
    )


def _report(rows: list[dict[str, Any]], minutes: float) -> dict[str, Any]:
    kept = sum(row["obeyed"] for row in rows)
    falls = sum(row["fell"] for row in rows)
    low, high = wilson(kept, len(rows))
    by_kind = {}
    for kind in sorted({row["kind"] for row in rows}):
        of_kind = [row for row in rows if row["kind"] == kind]
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
