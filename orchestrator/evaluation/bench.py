"""`bench loop`, `bench planner`, `bench tracker`, `bench transport`: speed over the real services."""

from __future__ import annotations

import asyncio
import time
import uuid
from collections.abc import Awaitable, Callable
from math import ceil
from typing import Any

import numpy as np
import psutil

from orchestrator.core.character import CharacterSession, CharacterSpec
from orchestrator.core.command import Command
from orchestrator.core.events import EventLog
from orchestrator.core.services import Services
from orchestrator.evaluation.commands import KindsOption, choose
from orchestrator.evaluation.statistics import percentiles
from shared.plugins.conformance import sample_request
from shared.plugins.interfaces import PlannerSpec
from shared.protocol.control import Ok
from shared.protocol.messages import (
    PLANNER_FPS,
    TICK_HZ,
    CloseCharacter,
    CreateCharacter,
    GetTicks,
    Observe,
    Plan,
    PlanRequest,
    StateFrame,
    Step,
    TickRange,
    Track,
    TrackReply,
)

COMMAND_EVERY_S = 3.0
JOIN_EVERY_S = 0.3
"""Characters come one after another, as people do."""
TEXTS = ("a person is walking.", "a person is standing still.", "a person waves with the right hand.")


async def bench_loop(
    services: Services,
    characters: int,
    seconds: float,
    seed: int,
    planner: str | None = None,
    tracker: str | None = None,
    say: Callable[[str], None] | None = None,
    kinds: KindsOption | None = None,
) -> dict[str, Any]:
    """Realtime characters that come one after another and are given a new command every three seconds or so, at any
    time: walking, standing or waving, or what `eval text` asks for with these kinds.

    Returns:
        realtime_factor: simulated over wall time; missed_ticks, missed_share; late_plans: dropped or entered late;
        command_to_motion_ms: from a command to the tick at which the first plan made for it enters; plan_ms: from a
        plan's request until it is handed over.
    """
    specs = [
        CharacterSpec(pacing="realtime", seed=seed + i, planner=planner, tracker=tracker) for i in range(characters)
    ]
    sessions = [CharacterSession(str(uuid.uuid4()), spec, services, EventLog()) for spec in specs]
    for session in sessions:
        await session.start()
        await asyncio.sleep(JOIN_EVERY_S)
    commands: list[list[tuple[int, str]]] = [[] for _ in sessions]
    rounds = ceil(seconds / COMMAND_EVERY_S)
    texts = TEXTS if kinds is None else tuple(asked.text for asked in choose(rounds + characters, seed, kinds))
    falls, rng = 0, np.random.default_rng(seed)
    began, first_ticks = time.perf_counter(), [session.state.tick for session in sessions]
    for number in range(rounds * characters):
        step, i = divmod(number, characters)
        due_s = (number + 0.2 * float(rng.uniform())) * COMMAND_EVERY_S / characters  # at any phase of plans
        await asyncio.sleep(max(0.0, due_s - (time.perf_counter() - began)))
        session, text = sessions[i], texts[(step + i) % len(texts)]
        if session.state.fallen:
            falls += 1
            await session.reset()
        commands[i].append((session.set_command(Command(text=text)), text))
        if say is not None and i == 0:
            missed = sum(s.state.missed_ticks for s in sessions)
            say(f"{time.perf_counter() - began:.0f} of {seconds:.0f} s, missed ticks {missed}")
    await asyncio.sleep(max(0.0, seconds - (time.perf_counter() - began)))
    wall_s = time.perf_counter() - began
    states = [await session.loop.observe() for session in sessions]
    ticks = [state.tick - first for state, first in zip(states, first_ticks, strict=True)]
    plans = [[e.data for e in session.events.since(0) if e.type == "plan"] for session in sessions]
    for session in sessions:
        await session.close()
    missed = sum(state.missed_ticks for state in states)
    latencies = [ms for i, given in enumerate(commands) for ms in _latencies(given, plans[i])]
    every = [plan for own in plans for plan in own]
    late = sum(1 for plan in every if not plan["accepted"] or plan["entered_tick"] != plan["start_tick"])
    return {
        "characters": characters,
        "seconds": round(wall_s, 2),
        "realtime_factor": round(float(np.mean(ticks)) / TICK_HZ / wall_s, 4),
        "missed_ticks": missed,
        "missed_share": round(missed / max(sum(ticks), 1), 6),
        "command_to_motion_ms": percentiles(latencies, 50, 95),
        "plan_ms": percentiles([plan["total_ms"] for plan in every], 50, 95),
        "plans": len(every),
        "late_plans": late,
        "falls": falls,
    }


MISSED_SHARE = 0.005
"""More missed ticks than this are no real time."""


async def most_characters(
    bench: Callable[[int], Awaitable[dict[str, Any]]], most: int, say: Callable[[str], None] | None = None
) -> dict[str, Any]:
    """The largest number of characters at which hardly a tick is missed and no plan is late, by doubling and halving.

    Args:
        bench: `bench_loop` for a number of characters.
        most: more are not tried.

    Returns:
        max_characters (0: not even one), and the rows of `bench` by number.
    """
    rows: dict[int, dict[str, Any]] = {}

    async def keeps_up(characters: int) -> bool:
        if say is not None:
            say(f"{characters} characters ...")
        row = rows[characters] = await bench(characters)
        return bool(row["missed_share"] < MISSED_SHARE and row["late_plans"] == 0)

    good, bad = 0, most + 1
    while bad - good > 1:
        doubled = max(1, 2 * good)
        tried = doubled if doubled < bad else (good + bad) // 2
        good, bad = (tried, bad) if await keeps_up(tried) else (good, tried)
    return {"max_characters": good, "missed_share_allowed": MISSED_SHARE, "rows": [rows[n] for n in sorted(rows)]}


def _latencies(given: list[tuple[int, str]], plans: list[dict[str, Any]]) -> list[float]:
    """Milliseconds from each command to the entry of the first plan that was made for it."""
    out = []
    for tick, text in given:
        entered = [p["entered_tick"] for p in plans if p["accepted"] and p["text"] == text and p["start_tick"] > tick]
        if entered:
            out.append((min(entered) - tick) * 1e3 / TICK_HZ)
    return out


async def bench_planner(services: Services, pid: int, repeats: int = 5) -> dict[str, Any]:
    """Every plug-in that the planner service offers, over the wire, one plan at a time and eight at once.

    Args:
        pid: of the planner's process, whose CPU time is read.
    """
    process = psutil.Process(pid)
    plugins = []
    for entry in services.planner.welcome.plugins:
        spec = PlannerSpec.model_validate(entry)
        await _plans(services, spec, 1)
        one = [await _timed(services, spec, 1, process) for _ in range(repeats)]
        eight = [await _timed(services, spec, 8, process) for _ in range(max(1, repeats // 2))]
        wall_b1, cpu_b1 = (float(np.median([row[i] for row in one])) for i in (0, 1))
        cpu_b8 = float(np.median([row[1] for row in eight])) / 8
        frames = min(40, spec.plan_frames)
        plugins.append(
            {
                "name": spec.name,
                "weights_sha256": spec.weights_sha256,
                "cpu_ms_per_plan_b1": round(cpu_b1, 2),
                "wall_ms_b1": round(wall_b1, 2),
                "cpu_ms_per_plan_b8": round(cpu_b8, 2),
                "frames_per_s": round(frames / (wall_b1 / 1e3), 1),
            }
        )
    return {"plugins": plugins}


async def _timed(services: Services, spec: PlannerSpec, batch: int, process: psutil.Process) -> tuple[float, float]:
    cpu, wall = process.cpu_times(), time.perf_counter()
    await _plans(services, spec, batch)
    after = process.cpu_times()
    cpu_ms = (after.user + after.system - cpu.user - cpu.system) * 1e3
    return (time.perf_counter() - wall) * 1e3, cpu_ms


async def _plans(services: Services, spec: PlannerSpec, batch: int) -> None:
    request: PlanRequest = sample_request(spec, text=TEXTS[0], planner=spec.name)
    await asyncio.gather(
        *(services.planner.ask(Plan, request, f"bench-{i}", timeout_s=120.0) for i in range(batch))
    )  # fmt: skip


async def bench_tracker(services: Services, seconds: float = 10.0) -> dict[str, Any]:
    """Wall time of a control tick of every tracker plug-in, over the wire in steps of one second, standing."""
    out = {}
    for entry in services.tracker.welcome.plugins:
        name = str(entry["name"])
        character = f"bench-{uuid.uuid4().hex[:8]}"
        await services.tracker.ask(StateFrame, CreateCharacter(tracker=name), character)
        times = []
        for _ in range(round(seconds)):
            began = time.perf_counter()
            await services.tracker.ask(StateFrame, Step(ticks=TICK_HZ), character, timeout_s=60.0)
            times.append((time.perf_counter() - began) / TICK_HZ * 1e6)
        await services.tracker.ask(Ok, CloseCharacter(), character)
        out[name] = {"tick_us": round(float(np.median(times)), 1)}
    return {"trackers": out}


async def bench_transport(services: Services, repeats: int = 300) -> dict[str, Any]:
    """Round trips to the tracker: a state, 20 prefix frames, and a plan handed over."""
    character = f"bench-{uuid.uuid4().hex[:8]}"
    tracker = services.tracker
    await tracker.ask(StateFrame, CreateCharacter(tracker=tracker.plugin), character)
    spec = PlannerSpec.model_validate(services.planner.spec())
    plan = await services.planner.ask(Plan, sample_request(spec, start_tick=0), character, timeout_s=60.0)
    track = Track(start_tick=0, positions_w_m=plan.positions_w_m, rotations_6d=plan.rotations_6d)

    async def measure(action: Callable[[], Any]) -> dict[str, float | None]:
        times = []
        for _ in range(repeats):
            began = time.perf_counter()
            await action()
            times.append((time.perf_counter() - began) * 1e3)
        return percentiles(times, 50, 95)

    result = {
        "observe_ms": await measure(lambda: tracker.ask(StateFrame, Observe(), character)),
        "prefix_ms": await measure(
            lambda: tracker.ask(TickRange, GetTicks(start_tick=-TICK_HZ, stop_tick=1, rate_hz=PLANNER_FPS), character)
        ),
        "track_ms": await measure(lambda: tracker.ask(TrackReply, track, character)),
    }
    await tracker.ask(Ok, CloseCharacter(), character)
    return {"repeats": repeats, **result}
