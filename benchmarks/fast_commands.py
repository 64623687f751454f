"""Whether commands that come faster than plans steer a character or starve it.

    python benchmarks/fast_commands.py --rate 10 --seconds 20 --json out/bench_fast_commands.json

The planner's own rate is taken first and last, plans asked for one after the other while no character runs. Then one
realtime character gets `--rate` commands a second for so long: to a fixed place, and to a place that goes round in a
circle. Nobody can need more plans than there are commands, so plans delivered are counted against the planner's own
rate or the commands', whichever is less. Planner and tracker are the trained ones unless others are named.
"""

from __future__ import annotations

import argparse
import asyncio
import sys
import tempfile
import time
from math import cos, hypot, pi, sin
from pathlib import Path
from typing import Any, Literal

from orchestrator.cli.common import provenance, write_json
from orchestrator.core.character import CharacterSession, CharacterSpec
from orchestrator.core.command import Command, Target
from orchestrator.core.events import EventLog
from orchestrator.core.services import Services, connect
from orchestrator.core.supervise import Stack, StackOptions
from orchestrator.evaluation.statistics import percentiles
from shared.plugins.conformance import sample_request
from shared.plugins.interfaces import PlannerSpec
from shared.protocol.messages import Plan

Way = Literal["fixed", "circle"]
WAYS: tuple[Way, ...] = ("fixed", "circle")
FIXED_M = (2.0, 1.5)
CIRCLE_M, ROUND_S = 1.5, 24.0
"""0.4 m/s: a slow walk."""
NEAR_M = 0.3
ARRIVE_WITHIN_S = 20.0
LEAST_SHARE = 0.8
OWN_RATE_S = 4.0


def place(way: Way, seconds: float) -> tuple[float, float, float]:
    """Where the target is; a circle begins at the origin, where the character stands, and goes off to its left."""
    if way == "fixed":
        return (*FIXED_M, 0.0)
    angle = 2 * pi * seconds / ROUND_S
    return (CIRCLE_M * sin(angle), CIRCLE_M * (1 - cos(angle)), 0.0)


async def plans_per_s(services: Services, seconds: float = OWN_RATE_S) -> float:
    """How fast the planner makes plans to a target, each asked for when the one before is there."""
    spec = PlannerSpec.model_validate(services.planner.spec())
    request = sample_request(spec, text="a person is walking.", planner=spec.name)
    await services.planner.ask(Plan, request, "own-rate", timeout_s=120.0)
    began, made = time.monotonic(), 0
    while time.monotonic() - began < seconds:
        await services.planner.ask(Plan, request, "own-rate", timeout_s=120.0)
        made += 1
    return made / (time.monotonic() - began)


async def commanded(services: Services, way: Way, rate: float, seconds: float, seed: int) -> dict[str, Any]:
    """One character under commands: plans delivered a second, how far from the target, when it arrived."""
    session = CharacterSession(f"{way}-{seed}", CharacterSpec(pacing="realtime", seed=seed), services, EventLog())

    def away_m(target: tuple[float, float, float]) -> float:
        x, y = (float(v) for v in session.state.body_pos_w_m[0, :2])
        return hypot(x - target[0], y - target[1])

    try:
        await session.start()
        began, sent, away = time.monotonic(), 0, []
        while (now := time.monotonic() - began) < seconds:
            target = place(way, now)
            session.set_command(Command(target=Target(position_m=target)))
            sent += 1
            away.append(away_m(target))
            await asyncio.sleep(max(0.0, sent / rate - (time.monotonic() - began)))
        took = time.monotonic() - began
        plans = [event.data for event in session.events.since(0) if event.type == "plan"]
        left = time.monotonic()
        while (end := away_m(target)) > NEAR_M and time.monotonic() - left < ARRIVE_WITHIN_S:
            await asyncio.sleep(0.05)
        return {
            "way": way,
            "commands_per_s": round(sent / took, 2),
            "plans_per_s": round(sum(bool(plan["accepted"]) for plan in plans) / took, 2),
            "dropped_plans": sum(not plan["accepted"] for plan in plans),
            "plan_ms": percentiles([plan["total_ms"] for plan in plans], 50, 95),
            "mean_away_m": round(sum(away[len(away) // 2 :]) / max(len(away) - len(away) // 2, 1), 3),
            "end_away_m": round(end, 3),
            "arrived_after_s": round(time.monotonic() - left, 2) if end <= NEAR_M else None,
            "falls": sum(event.type == "fallen" for event in session.events.since(0)),
            "missed_ticks": session.state.missed_ticks,
        }
    finally:
        await session.close()


async def measure(
    planner: str, tracker: str, rate: float, seconds: float, seed: int,
    plugins: tuple[str | None, str | None] = (None, None), ways: tuple[Way, ...] = WAYS,
) -> dict[str, Any]:  # fmt: skip
    """The planner's own rate, and each way against it."""
    services = Services(await connect(planner, "planner", plugins[0]), await connect(tracker, "tracker", plugins[1]))
    try:
        own = [await plans_per_s(services)]
        runs = []
        for way in ways:
            runs.append(await commanded(services, way, rate, seconds, seed))
            own.append(await plans_per_s(services))
            between = 0.5 * (own[-2] + own[-1])
            runs[-1]["own_rate"] = round(between, 2)
            runs[-1]["share"] = round(runs[-1]["plans_per_s"] / min(between, runs[-1]["commands_per_s"]), 3)
        return {
            "planner": services.planner.plugin_name,
            "tracker": services.tracker.plugin_name,
            "own_rates": [round(r, 2) for r in own],
            "runs": runs,
        }
    finally:
        await services.close()


def steered(result: dict[str, Any]) -> bool:
    """Whether plans were delivered at 0.8 of the lesser rate, and the character came where it should."""
    return all(run["share"] >= LEAST_SHARE and run["arrived_after_s"] is not None for run in result["runs"])


def main() -> int:
    """Exit code 1 when commands starved the character, or it did not come to the last target."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rate", type=float, default=10.0, help="commands a second")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--planner", default=None, help="planner plug-in")
    parser.add_argument("--tracker", default=None, help="tracker plug-in")
    parser.add_argument("--json", type=Path, default=None, help="write the result to this file")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        stack = Stack(StackOptions(data_dir=str(Path(folder) / "data")), lambda line: sys.stderr.write(f"{line}\n"))
        try:
            stack.start_services()
            addresses = stack.planner.address, stack.tracker.address
            plugins = given.planner, given.tracker
            result = asyncio.run(measure(*addresses, given.rate, given.seconds, given.seed, plugins))
        finally:
            stack.stop()
    command = " ".join(["python", "benchmarks/fast_commands.py", *sys.argv[1:]])
    write_json(given.json, {**result, **provenance(given.seed), "command": command})
    return 0 if steered(result) else 1


if __name__ == "__main__":
    sys.exit(main())
