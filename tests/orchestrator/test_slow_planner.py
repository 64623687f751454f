"""A planner slower than the lead of its plans still moves the character: plans are asked for as early as they take."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path

import pytest

from orchestrator.core.character import CharacterSession, CharacterSpec
from orchestrator.core.events import EventLog
from orchestrator.core.lead import MOST_TICKS, PlanLead
from orchestrator.core.services import Services, connect
from orchestrator.core.supervise import Stack
from planner_service.builtin.stand import StandPlanner
from planner_service.service.service import PlannerService
from planner_service.service.settings import PlannerSettings
from shared.plugins.interfaces import Planner
from shared.plugins.registry import PLANNERS, PluginRegistry
from shared.protocol.messages import Plan, PlanRequest
from tests.orchestrator.support import light

PLAN_S = 0.9
"""Over the lead of 0.4 s and the 0.3 s by which a plan may be late."""
GIVE_UP_S = 120.0


@pytest.mark.parametrize(
    ("took_s", "ticks"),
    [
        ([], 12),
        ([0.1, 0.2], 12),
        ([0.9], 27),
        ([0.1, 0.1, 0.1, 0.1, 5.0], 12),  # one that hung is no measure
        ([0.5, 1.0, 1.0, 1.2, 9.0], 36),
        ([9.0] * 3, MOST_TICKS),
        ([9.0] * 5 + [0.1] * 4, 12),  # it has recovered
    ],
)
def test_the_lead_is_the_settings_or_what_plans_take(took_s: list[float], ticks: int) -> None:
    lead = PlanLead(12)
    for seconds in took_s:
        lead.took(seconds)
    assert lead.ticks == ticks


class Slow:
    """Stands, after a while."""

    def __init__(self) -> None:
        self.spec = StandPlanner().spec

    def plan(self, requests: list[PlanRequest]) -> list[Plan]:
        time.sleep(PLAN_S)
        return StandPlanner().plan(requests)


async def entered(planner: str, tracker: str, plans: int) -> list[bool]:
    """Which of the first plans of a realtime character were taken by the tracker."""
    services = Services(await connect(planner, "planner", "stand"), await connect(tracker, "tracker", "kinematic"))
    session = CharacterSession("slow", CharacterSpec(pacing="realtime"), services, EventLog())
    try:
        await session.start()
        while len(found := [event for event in session.events.since(0) if event.type == "plan"]) < plans:
            await asyncio.sleep(0.05)
        return [bool(event.data["accepted"]) for event in found]
    finally:
        await session.close()
        await services.close()


def test_plans_that_take_longer_than_their_lead_enter_all_the_same(tmp_path: Path) -> None:
    planner: Planner = Slow()
    registry: PluginRegistry[Planner] = PluginRegistry(PLANNERS, {"stand": lambda: planner})
    stack = Stack(light(tmp_path))
    stack.tracker.start()
    try:
        endpoint = stack.tracker.wait_ready(60.0)
        with PlannerService(PlannerSettings(endpoint="tcp://127.0.0.1:0"), registry=registry) as service:
            taken = asyncio.run(asyncio.wait_for(entered(service.endpoint, endpoint, 8), GIVE_UP_S))
    finally:
        stack.stop()
    assert sum(taken) >= 2
