"""Whatever a planner or the loop raises ends in a state that can be seen, and the planner goes on for the others."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

import pytest

from orchestrator.core.character import REFUSALS_IN_A_ROW, CharacterSession, CharacterSpec
from orchestrator.core.command import Command
from orchestrator.core.events import EventLog
from orchestrator.core.services import Services, connect
from orchestrator.core.supervise import Stack
from planner_service.builtin.stand import StandPlanner
from planner_service.service.service import PlannerService
from planner_service.service.settings import PlannerSettings
from shared.errors import MotionLoopError
from shared.plugins.interfaces import Planner
from shared.plugins.registry import PLANNERS, PluginRegistry
from shared.protocol.messages import Plan, PlanRequest
from tests.orchestrator.support import light

GIVE_UP_S = 60.0


def raise_value(requests: list[PlanRequest]) -> list[Plan]:
    raise ValueError("a bug of its own")


def leave(requests: list[PlanRequest]) -> list[Plan]:
    raise SystemExit("out of here")


def nothing(requests: list[PlanRequest]) -> list[Plan]:
    return [None for _ in requests]  # type: ignore[misc]


class Breaking:
    """Stands, but while `broken` does what `how` does with every request."""

    def __init__(self, how: Callable[[list[PlanRequest]], list[Plan]]) -> None:
        self.spec = StandPlanner().spec
        self.broken = False
        self._how = how

    def plan(self, requests: list[PlanRequest]) -> list[Plan]:
        return self._how(requests) if self.broken else StandPlanner().plan(requests)


async def seen(session: CharacterSession, type: str) -> str:
    """The reason of the first event of a type; waits for it."""
    async for event in session.events.listen():
        if event.type == type:
            return str(event.data.get("reason"))
    raise AssertionError(f"never: {type}")


async def break_and_mend(planner: Breaking, endpoint: str, tracker: str) -> None:
    services = Services(await connect(endpoint, "planner", "stand"), await connect(tracker, "tracker", "kinematic"))
    session = CharacterSession("breaker", CharacterSpec(pacing="realtime"), services, EventLog())
    try:
        await session.start()
        await seen(session, "plan")
        planner.broken = True
        session.set_command(Command(text="walk"))
        assert "the planner fails" in await seen(session, "failed")
        assert session.status == "failed" and "stand" in str(session.reason)
        refused = [event for event in session.events.since(0) if event.type == "plan_refused"]
        assert len(refused) == REFUSALS_IN_A_ROW + 1
        planner.broken = False
        plans = session.loop.plans_made
        await session.reset()
        assert session.status == "running" and session.reason is None
        while session.loop.plans_made == plans:
            await asyncio.sleep(0.01)
    finally:
        await session.close()
        await services.close()


async def break_the_loop(endpoint: str, tracker: str, pacing: str) -> None:
    services = Services(await connect(endpoint, "planner", "stand"), await connect(tracker, "tracker", "kinematic"))
    spec = CharacterSpec.model_validate({"pacing": pacing})
    session = CharacterSession(f"broken-{pacing}", spec, services, EventLog())

    def broken(view: object, plan_tick: int) -> object:
        raise ZeroDivisionError("in a goal")

    try:
        await session.start()
        session._goal = broken  # type: ignore[assignment,method-assign]
        if pacing == "lockstep":
            with pytest.raises(MotionLoopError, match="ZeroDivisionError"):
                await session.advance(30)
        assert "ZeroDivisionError: in a goal" in await seen(session, "failed")
        assert session.status == "failed"
    finally:
        await session.close()
        await services.close()


@pytest.mark.parametrize("how", [raise_value, leave, nothing])
def test_a_planner_that_breaks_fails_the_character_which_a_reset_brings_back(
    tmp_path: Path, how: Callable[[list[PlanRequest]], list[Plan]]
) -> None:
    planner = Breaking(how)
    registry: PluginRegistry[Planner] = PluginRegistry(PLANNERS, {"stand": lambda: planner})
    stack = Stack(light(tmp_path))
    stack.tracker.start()
    try:
        tracker = stack.tracker.wait_ready(60.0)
        with PlannerService(PlannerSettings(endpoint="tcp://127.0.0.1:0"), registry=registry) as service:
            asyncio.run(asyncio.wait_for(break_and_mend(planner, service.endpoint, tracker), GIVE_UP_S))
    finally:
        stack.stop()


def test_a_bug_in_a_characters_own_task_is_a_failed_character(tmp_path: Path) -> None:
    stack = Stack(light(tmp_path))
    try:
        endpoints = stack.start_services()
        for pacing in ("realtime", "lockstep"):
            asyncio.run(asyncio.wait_for(break_the_loop(*endpoints, pacing), GIVE_UP_S))
    finally:
        stack.stop()
