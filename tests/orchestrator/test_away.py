"""A service that was away is used again as soon as it is there, whatever the time-outs are; no test waits for one."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from orchestrator.core.drivers import PLANNER_RETRY_TICKS, LockstepDriver
from orchestrator.core.loop import CharacterLoop
from orchestrator.core.services import Services, connect
from orchestrator.core.settings import LOCKSTEP
from orchestrator.core.supervise import Stack
from planner_service.builtin.stand import StandPlanner
from planner_service.service.service import PlannerService
from planner_service.service.settings import PlannerSettings
from shared.errors import DeadlineError, OverloadedError
from shared.plugins.interfaces import Planner
from shared.plugins.registry import PLANNERS, PluginRegistry
from shared.protocol import client as protocol_client
from shared.protocol.base import Message
from shared.protocol.control import Envelope, Health
from shared.protocol.messages import CreateCharacter, Plan, PlanRequest, StateFrame, Step, Track, TrackReply
from shared.protocol.transport import ServiceServer
from shared.tasks.interface import PlanGoal
from tests.orchestrator.support import light
from tests.protocol.chaos_proxy import ChaosProxy
from tests.protocol.test_transport import TRACK, Counting, report, welcome

NEVER_S = 3600.0
GIVE_UP_S = 300.0


async def until(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(GIVE_UP_S):
        while not condition():
            await asyncio.sleep(0.01)


def test_a_reply_counts_although_the_service_does_not_say_how_it_is() -> None:
    service, asked, gate = Counting(), threading.Event(), threading.Event()

    def health(envelope: Envelope, message: Health) -> Message:
        asked.set()
        gate.wait()
        return report()

    async def run(endpoint: str) -> None:
        slot = await connect(endpoint, "tracker", timeout_s=GIVE_UP_S)
        asking = asyncio.create_task(slot.ask(TrackReply, TRACK, "a", NEVER_S, patience_s=0.01, health_s=NEVER_S))
        await until(lambda: asked.is_set() and len(service.futures) == 1)
        service.futures[0].set_result(TrackReply(accepted=True, tick=7))
        async with asyncio.timeout(GIVE_UP_S):
            assert (await asking).tick == 7
        await slot.client.close()

    with ServiceServer("tcp://127.0.0.1:0", {Track: service.track, Health: health}, welcome) as server:
        try:
            asyncio.run(run(server.endpoint))
        finally:
            gate.set()


def test_a_service_that_was_silent_is_noticed_before_anyone_loses_patience(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(protocol_client, "RESEND_S", NEVER_S)
    service = Counting()

    async def run(line: ChaosProxy) -> None:
        slot = await connect(line.endpoint, "tracker", timeout_s=GIVE_UP_S)
        line.share = 1.0
        with pytest.raises(DeadlineError):
            await slot.ask(TrackReply, Step(ticks=1), "a", 0.05, NEVER_S, NEVER_S)
        asking = asyncio.create_task(slot.ask(TrackReply, Step(ticks=2), "a", NEVER_S, NEVER_S, NEVER_S))
        dropped = line.done["drop"]
        await until(lambda: line.done["drop"] >= dropped + 3)  # the request and two questions for its health
        line.share = 0.0
        async with asyncio.timeout(GIVE_UP_S):
            assert (await asking).accepted
        await slot.client.close()

    with service.server() as server, ChaosProxy(server.endpoint, seed=1, share=0.0) as line:
        line.faults = ("drop",)
        asyncio.run(run(line))
    assert service.executed == [("a", 2)]


class Busy:
    """Stands, but refuses the first plans."""

    def __init__(self, refusals: int) -> None:
        self.spec = StandPlanner().spec
        self._refusals = refusals

    def plan(self, requests: list[PlanRequest]) -> list[Plan]:
        if self._refusals > 0:
            self._refusals -= 1
            raise OverloadedError("busy")
        return StandPlanner().plan(requests)


async def ticks_and_troubles(planner: str, tracker: str, cycles: int) -> list[tuple[int, str | None]]:
    """Where a lockstep character is after each cycle, and why no plan came in it."""
    services = Services(await connect(planner, "planner", "stand"), await connect(tracker, "tracker", "kinematic"))
    try:
        loop = CharacterLoop("patient", services, LOCKSTEP, seed=1)
        state = await loop.ask_tracker(StateFrame, CreateCharacter(tracker="kinematic"))
        driver = LockstepDriver(loop, state)
        done = [await driver.cycle(lambda view, tick: PlanGoal(text="stand")) for _ in range(cycles)]
        return [(cycle.state.tick, cycle.planner_error) for cycle in done]
    finally:
        await services.close()


def test_in_lockstep_too_a_planner_that_is_away_is_asked_again_soon(tmp_path: Path) -> None:
    planner: Planner = Busy(2)
    registry: PluginRegistry[Planner] = PluginRegistry(PLANNERS, {"stand": lambda: planner})
    stack = Stack(light(tmp_path))
    stack.tracker.start()
    try:
        endpoint = stack.tracker.wait_ready()
        with PlannerService(PlannerSettings(endpoint="tcp://127.0.0.1:0"), registry=registry) as service:
            found = asyncio.run(ticks_and_troubles(service.endpoint, endpoint, 3))
    finally:
        stack.stop()
    soon = PLANNER_RETRY_TICKS
    assert found == [(soon, "busy"), (2 * soon, "busy"), (2 * soon + LOCKSTEP.replan_ticks, None)]
