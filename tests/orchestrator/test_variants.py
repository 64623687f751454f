"""The variants of the loop over the real services: how often each looks at the body, and how long its plans are."""

from __future__ import annotations

import asyncio
import uuid

import numpy as np
import pytest

from orchestrator.core.chain import chained, following
from orchestrator.core.drivers import LockstepDriver
from orchestrator.core.loop import CharacterLoop
from orchestrator.core.services import Services, connect
from orchestrator.core.settings import VARIANTS, LoopSettings
from orchestrator.core.supervise import Stack
from planner_service.builtin.stand import StandPlanner
from planner_service.service.service import PlannerService
from planner_service.service.settings import PlannerSettings
from shared.errors import InvalidInputError
from shared.motion.ik import standing_clip
from shared.plugins.conformance import sample_request
from shared.plugins.interfaces import Planner
from shared.plugins.registry import PLANNERS, PluginRegistry
from shared.protocol.messages import CreateCharacter, PlanRequest, StateFrame
from shared.tasks.interface import PlanGoal
from tests.orchestrator.support import Noting


def drive(
    stack: Stack, settings: LoopSettings, ticks: int,
    goal: PlanGoal | None = None, tracker: str = "kinematic",
) -> tuple[list[PlanRequest], list[int], list[int]]:  # fmt: skip
    """Requests that reached the planner, the ticks plans were made at, and the lengths handed to the tracker."""
    planner = Noting(plan_frames=40)
    registry: PluginRegistry[Planner] = PluginRegistry(PLANNERS, {"stand": lambda: planner})

    async def run(endpoint: str) -> tuple[list[int], list[int]]:
        services = Services(
            await connect(endpoint, "planner", "stand"), await connect(stack.tracker.address, "tracker", tracker)
        )
        loop = CharacterLoop(str(uuid.uuid4()), services, settings, seed=3)
        state = await loop.ask_tracker(StateFrame, CreateCharacter(tracker=tracker))
        driver, made, lengths = LockstepDriver(loop, state), [], []
        try:
            while state.tick < ticks:
                at = state.tick
                cycle = await driver.cycle(lambda view, tick: goal or PlanGoal(text="stand"))
                state = cycle.state
                if cycle.plans and loop.last_plan is not None:
                    made.append(at)
                    lengths.append(len(loop.last_plan.positions_w_m))
        finally:
            await services.close()
        return made, lengths

    with PlannerService(PlannerSettings(endpoint="tcp://127.0.0.1:0"), registry=registry) as service:
        made, lengths = asyncio.run(run(service.endpoint))
    return planner.asked, made, lengths


@pytest.mark.parametrize(
    ("variant", "every", "frames", "requests_each"),
    [("closed_loop", 30, 40, 1), ("paper", 60, 40, 1), ("short", 15, 10, 1), ("long", 120, 80, 2)],
)
def test_how_often_a_variant_plans_and_how_far(
    stack: Stack, variant: str, every: int, frames: int, requests_each: int
) -> None:
    asked, made, lengths = drive(stack, VARIANTS[variant], 240)
    assert made == list(range(0, 240, every))
    assert set(lengths) == {frames}
    assert len(asked) == requests_each * len(made)
    assert {request.horizon_frames for request in asked} == {frames // requests_each}


def test_the_second_plan_of_a_chain_goes_on_from_the_first(stack: Stack) -> None:
    asked, made, _ = drive(stack, VARIANTS["long"], 240)
    assert [request.start_tick for request in asked] == [0, 60, 120, 180]
    assert len({request.seed for request in asked}) == 4
    assert all(r.context_frames == len(r.prefix_positions_w_m) for r in asked[1::2]), "nothing of it was simulated"
    assert made == [0, 120]


@pytest.mark.parametrize(("variant", "by_plan"), [("open_loop", True), ("closed_loop", False)])
def test_only_open_loop_goes_on_from_the_plan_whatever_the_body_does(stack: Stack, variant: str, by_plan: bool) -> None:
    """`pd` sags under its weight: the body is not where the plan says."""
    asked, _, _ = drive(stack, VARIANTS[variant], 120, tracker="pd")
    assert len(asked) == 4
    last_m = StandPlanner().plan(asked[:1])[0].positions_w_m[19]  # the next request goes on from frame 20
    off_m = np.abs(asked[1].prefix_positions_w_m[-1] - last_m).max()
    assert off_m < 1e-5 if by_plan else off_m > 1e-3


@pytest.mark.parametrize(
    ("goal", "setting", "sent"), [(None, None, None), (None, 2.0, 2.0), (4.0, 2.0, 4.0), (0.0, 2.0, 0.0)]
)
def test_guidance_is_the_goals_else_the_settings_else_the_planners(
    stack: Stack, goal: float | None, setting: float | None, sent: float | None
) -> None:
    asked, _, _ = drive(stack, LoopSettings(guidance=setting), 15, goal=PlanGoal(text="walk", guidance=goal))
    assert asked[0].guidance == sent


def test_a_chain_by_hand() -> None:
    request = sample_request(StandPlanner().spec, start_tick=30)
    moving = np.asarray(standing_clip(40, 20.0).positions_w_m, dtype="<f4").copy()
    moving[:, :, 0] += np.arange(40)[:, None] * 0.05  # 1 m/s
    plan = StandPlanner().plan([request])[0]
    first = plan.model_copy(update={"positions_w_m": moving, "rotations_6d": plan.rotations_6d[:40]})
    after = following(request, first, seed=9)
    assert (after.start_tick, after.seed) == (90, 9)
    np.testing.assert_allclose(after.prefix_positions_w_m, moving[-len(request.prefix_positions_w_m) :])
    np.testing.assert_allclose(after.prefix_velocities_w_mps[:, 0, 0], 1.0, atol=1e-4)
    both = chained(first, first)
    assert len(both.positions_w_m) == len(both.rotations_6d) == 80
    with pytest.raises(InvalidInputError, match="between two ticks"):
        following(request, first.model_copy(update={"positions_w_m": moving[:39]}), seed=9)
