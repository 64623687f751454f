"""Plans that no body could follow: one is passed over, the old one goes on; too many in a row are an error."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from orchestrator.core.drivers import BAD_PLANS_IN_A_ROW, LockstepDriver
from orchestrator.core.loop import CharacterLoop
from orchestrator.core.services import Services, connect
from orchestrator.core.settings import LOCKSTEP
from planner_service.builtin.stand import StandPlanner
from shared.errors import SimulationError
from shared.protocol.messages import CreateCharacter, Plan, PlanRequest, StateFrame
from shared.tasks.interface import PlanGoal
from tests.orchestrator.support import served


class Leaping:
    """Stands, but for the first `bad` plans after it was asked to leap, which begin five metres away."""

    def __init__(self, bad: int) -> None:
        self.spec = StandPlanner().spec
        self._bad = bad

    def plan(self, requests: list[PlanRequest]) -> list[Plan]:
        return [self._one(request) for request in requests]

    def _one(self, request: PlanRequest) -> Plan:
        plan = StandPlanner().plan([request])[0]
        if request.text == "leap" and self._bad > 0:
            self._bad -= 1
            return plan.model_copy(update={"positions_w_m": plan.positions_w_m + 5.0})
        return plan


async def drive(planner: str, tracker: str, cycles: int) -> list[int]:
    """Ticks at which plans entered, over cycles of half a second."""
    services = Services(
        await connect(planner, "planner", "stand"), await connect(tracker, "tracker", "kinematic")
    )  # fmt: skip
    try:
        settings = LOCKSTEP.model_copy(update={"text_replan_ticks": 15})
        loop = CharacterLoop("leaper", services, settings, seed=1)
        state = await loop.ask_tracker(StateFrame, CreateCharacter(tracker="kinematic"))
        driver = LockstepDriver(loop, state)
        entered = []
        for cycle in range(cycles):
            text = "stand" if cycle == 0 else "leap"
            done = await driver.cycle(lambda view, tick, text=text: PlanGoal(text=text))
            assert done.planner_error is None
            assert done.state.tick == 15 * (cycle + 1)
            entered += [plan.entered_tick for plan in done.plans]
        return entered
    finally:
        await services.close()


@pytest.mark.parametrize("bad", [1, BAD_PLANS_IN_A_ROW, BAD_PLANS_IN_A_ROW + 1])
def test_bad_plans_are_passed_over_until_there_are_too_many(tmp_path: Path, bad: int) -> None:
    with served(Leaping(bad), tmp_path) as endpoints:
        run = drive(*endpoints, bad + 2)
        if bad > BAD_PLANS_IN_A_ROW:
            with pytest.raises(SimulationError, match="gave a joint"):
                asyncio.run(run)
        else:
            assert asyncio.run(run) == [0, 15 * (bad + 1)]
