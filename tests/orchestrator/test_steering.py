"""Commands faster than plans steer the character: none of them keeps a plan from landing, and the last one wins."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from math import cos, hypot, sin
from pathlib import Path

import pytest

from benchmarks.fast_commands import measure, steered
from orchestrator.core.character import CharacterSession, CharacterSpec
from orchestrator.core.command import Command, Target
from orchestrator.core.events import EventLog
from orchestrator.core.services import Services, connect
from orchestrator.core.supervise import Stack, StackOptions

PLANS = 12
NEAR_M = 0.6
GIVE_UP_S = 90.0

pytest.importorskip("torch", reason="the real planner needs torch")


def plans(session: CharacterSession) -> int:
    return sum(event.data["accepted"] for event in session.events.since(0) if event.type == "plan")


async def drag(planner: str, tracker: str, interval_s: float) -> None:
    """A target dragged round the character until so many plans are there, which old ones must not prevent."""
    services = Services(await connect(planner, "planner", "dip"), await connect(tracker, "tracker", "kinematic"))
    session = CharacterSession(f"dragged-{interval_s}", CharacterSpec(pacing="realtime"), services, EventLog())
    try:
        await session.start()
        sent = 0
        while plans(session) < PLANS:
            sent += 1
            angle = 0.1 * sent
            session.set_command(Command(target=Target(position_m=(1.5 * cos(angle), 1.5 * sin(angle), 0.0))))
            await asyncio.sleep(interval_s)
        assert session.status == "running"
        x, y = (float(v) for v in session.state.body_pos_w_m[0, :2])
        last = Target(position_m=(x - 1.5, y, 0.0))
        session.set_command(Command(target=last))
        while (away := hypot(*(session.state.body_pos_w_m[0, :2] - last.position_m[:2]))) > NEAR_M:
            assert not session.state.fallen, f"fell {away:.1f} m from the last target"
            await asyncio.sleep(0.05)
    finally:
        await session.close()
        await services.close()


@pytest.mark.parametrize("interval_s", [0.03, 0.1, 0.4])
def test_plans_land_and_the_last_target_is_reached(stack_with_dip: Stack, interval_s: float) -> None:
    endpoints = stack_with_dip.planner.address, stack_with_dip.tracker.address
    asyncio.run(asyncio.wait_for(drag(*endpoints, interval_s), GIVE_UP_S))


@pytest.mark.slow
def test_ten_commands_a_second_get_as_many_plans_as_the_planner_makes(stack_with_dip: Stack) -> None:
    """20 s to a fixed target and 20 s after one that goes round; the planner's own rate is taken in the same run."""
    endpoints = stack_with_dip.planner.address, stack_with_dip.tracker.address
    result = asyncio.run(measure(*endpoints, rate=10.0, seconds=20.0, seed=1, plugins=("dip", "kinematic")))
    assert steered(result), result


async def ask(planner: str, tracker: str) -> None:
    services = Services(await connect(planner, "planner", "dip"), await connect(tracker, "tracker", "kinematic"))
    session = CharacterSession("reader", CharacterSpec(pacing="lockstep"), services, EventLog())
    try:
        await session.start()
        far = await session.reading(Command(text="wave, then bake a cake"))
        assert far.nearest is not None and far.nearest.similarity < 0.5
        assert (await session.reading(Command(text="somebody jogs"))).nearest is None
        elbow = Command(target=Target(joint="left_elbow", position_m=(0.3, 0.3, 1.2)))
        assert (await session.reading(elbow)).unreachable_joints == ["left_elbow"]
        said = [event.data for event in session.events.since(0) if event.type == "understood"]
        assert [event["text"] for event in said] == ["wave, then bake a cake", None]
    finally:
        await session.close()
        await services.close()


def test_a_text_unlike_all_that_was_trained_is_answered_with_the_nearest(stack_with_dip: Stack) -> None:
    asyncio.run(asyncio.wait_for(ask(stack_with_dip.planner.address, stack_with_dip.tracker.address), GIVE_UP_S))


@pytest.fixture(scope="module")
def stack_with_dip(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    data: Path = tmp_path_factory.mktemp("data")
    stack = Stack(StackOptions(data_dir=str(data), planner_args=("--plugins", "dip")))
    try:
        stack.start_services()
        yield stack
    finally:
        stack.stop()
