"""A planner slower than the lead of its plans still moves the character: plans are asked for as early as they take."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path

import pytest

from orchestrator.core.character import CharacterSession, CharacterSpec
from orchestrator.core.events import EventLog
from orchestrator.core.lead import effort_of
from orchestrator.core.services import Services, connect
from planner_service.builtin.stand import StandPlanner
from shared.protocol.messages import JointTarget, Plan, PlanRequest
from shared.tasks.interface import PlanGoal
from tests.orchestrator.support import served

PLAN_S = 0.9
"""Over the first lead of 0.3 s and the 0.3 s by which a plan may be late."""
GIVE_UP_S = 120.0


@pytest.mark.parametrize(
    ("text", "effort"),
    [
        ("a person walks", "once"),
        ("wave with the left hand", "wave"),
        ("kick with the left foot", "blow"),
        (None, "once"),
    ],
)
def test_what_is_planned_for_several_times_is_known_by_its_words(text: str | None, effort: str) -> None:
    assert effort_of(PlanGoal(text=text)) == effort
    target = JointTarget(joint="left_wrist", position_w_m=(1.0, 0.0, 1.2), arrival_tick=60)
    assert effort_of(PlanGoal(text=text, targets=(target,))) == "once"


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
    with served(Slow(), tmp_path) as endpoints:
        taken = asyncio.run(asyncio.wait_for(entered(*endpoints, 8), GIVE_UP_S))
    assert sum(taken) >= 2
