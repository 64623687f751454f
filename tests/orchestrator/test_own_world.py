"""An open loop is told what it planned and never what the body does; only its success is judged by that."""

from __future__ import annotations

import asyncio
import uuid
from dataclasses import replace

import numpy as np
import pytest

from orchestrator.core.drivers import Cycle
from orchestrator.core.episode import EpisodeRunner
from orchestrator.core.episode_spec import EpisodeOutcome, EpisodeSpec
from orchestrator.core.events import EventLog
from orchestrator.core.own_world import as_planned, planned_at
from orchestrator.core.performing import Performing
from orchestrator.core.services import Services, connect
from orchestrator.core.settings import VARIANTS
from orchestrator.core.stitch import PlanBuffer
from orchestrator.core.supervise import Stack
from planner_service.service.service import PlannerService
from planner_service.service.settings import PlannerSettings
from shared.motion.ik import standing_clip
from shared.plugins.interfaces import Planner
from shared.plugins.registry import PLANNERS, PluginRegistry
from shared.protocol.control import Ok
from shared.protocol.messages import Impulse, Plan, PlanRequest
from shared.tasks.builtin import ReachTask
from shared.tasks.interface import BodyView, Trace
from shared.tasks.specs import ReachSpec
from shared.tasks.world import unfelt
from tests.orchestrator.support import Noting

STANDING_M = np.asarray(standing_clip(1, 20.0).positions_w_m[0], dtype=np.float64)
Asked = tuple[int, list[object], bytes]


class Gliding(Noting):
    """Plans whoever stands to glide ahead at 1 m/s, and remembers what it was asked."""

    def plan(self, requests: list[PlanRequest]) -> list[Plan]:
        return [self._glide(request, plan) for request, plan in zip(requests, super().plan(requests), strict=True)]

    def _glide(self, request: PlanRequest, plan: Plan) -> Plan:
        positions = np.repeat(np.asarray(request.prefix_positions_w_m)[-1:], len(plan.positions_w_m), axis=0)
        positions[..., 0] += (np.arange(len(positions), dtype=positions.dtype)[:, None] + 1) / plan.fps
        return plan.model_copy(update={"positions_w_m": positions})


def performed(stack: Stack, variant: str, push_ns: float, tracker: str = "pd") -> tuple[list[Asked], EpisodeOutcome]:
    """What was asked of the planner on the way to a point 1.5 m ahead, and how it ended."""
    planner = Gliding(plan_frames=40)
    registry: PluginRegistry[Planner] = PluginRegistry(PLANNERS, {"stand": lambda: planner})

    async def run(endpoint: str) -> EpisodeOutcome:
        services = Services(
            await connect(endpoint, "planner", "stand"), await connect(stack.tracker.address, "tracker")
        )
        spec = EpisodeSpec.model_validate(
            {
                "tasks": [{"type": "reach", "position_m": (1.5, 0.0)}], "scene": "flat", "pacing": "lockstep",
                "tracker": tracker, "loop": VARIANTS[variant], "on_fall": "stay",
            }
        )  # fmt: skip
        runner = EpisodeRunner(str(uuid.uuid4()), spec, services, EventLog())

        async def push(cycle: Cycle) -> None:
            if cycle.state.tick == 15 and push_ns:
                push = Impulse(body="pelvis", impulse_w_ns=(-push_ns, push_ns, 0.0))
                await runner.session.loop.ask_tracker(Ok, push)

        runner.on_cycle = push
        try:
            outcome = await runner.run()
            await runner.session.close()
            return outcome
        finally:
            await services.close()

    with PlannerService(PlannerSettings(endpoint="tcp://127.0.0.1:0"), registry=registry) as service:
        outcome = asyncio.run(run(service.endpoint))
    asked = [(r.start_tick, [*r.targets, r.heading], r.prefix_positions_w_m.tobytes()) for r in planner.asked]
    return asked, outcome


@pytest.mark.parametrize(("variant", "same"), [("open_loop", True), ("closed_loop", False)])
def test_a_push_changes_what_is_asked_in_a_closed_loop_and_nothing_in_an_open_one(
    stack: Stack, variant: str, same: bool
) -> None:
    alone, _ = performed(stack, variant, 0.0)
    pushed, _ = performed(stack, variant, 60.0)
    until = min(len(alone), len(pushed))  # a fall ends the task
    assert until >= 4
    assert (alone[:until] == pushed[:until]) is same


def test_where_it_goes_comes_from_the_plan_and_success_from_the_body(stack: Stack) -> None:
    """`pd` does not walk: the plan is there, and the body is not."""
    asked, outcome = performed(stack, "open_loop", 0.0)
    assert np.frombuffer(asked[3][2], dtype="<f4").reshape(-1, 22, 3)[-1, 0, 0] > 1.2, "the plan went on"
    assert not outcome.success
    assert outcome.results[0].measures["off_plan_m"] > 0.3
    _, followed = performed(stack, "open_loop", 0.0, tracker="kinematic")
    assert followed.results[0].seconds < 2.0, "the same plan, performed to the letter, gets near"
    assert followed.results[0].measures["off_plan_m"] < 0.01


def test_what_was_planned_at_a_tick_stays_when_a_later_plan_comes() -> None:
    buffer = PlanBuffer()
    assert planned_at(buffer, 0, 3) is None
    places = np.zeros((40, 22, 3)) + np.arange(40)[:, None, None] ** 2
    buffer.put(0, places)
    before = planned_at(buffer, 0, 16)
    assert before is not None
    np.testing.assert_allclose(before[:4, 0, 0], [0.0, 2 / 3, 2.0, 4.0], atol=1e-12)  # frames 0, 2/3, 4/3, 2
    buffer.put(11, places[:20] - 7.0)  # from tick 15 on
    after = planned_at(buffer, 0, 16)
    assert after is not None
    np.testing.assert_array_equal(before, after)
    held = planned_at(buffer, -9, 90)
    assert held is not None
    assert held[0, 0, 0] == places[0, 0, 0]
    assert held[-1, 0, 0] == places[19, 0, 0] - 7.0


def test_in_a_closed_loop_the_view_is_what_it_was() -> None:
    view = BodyView(3, STANDING_M, True, objects={"bag": np.zeros(7)})
    assert as_planned(view, None) is view
    there = as_planned(view, lambda start, stop: np.repeat(STANDING_M[None] + 1.0, stop - start, axis=0), {})
    np.testing.assert_array_equal(there.pos_w_m, STANDING_M + 1.0)
    assert (there.fallen, there.objects, there.tick) == (False, {}, 3)


def planned_ahead(start: int, stop: int) -> np.ndarray:
    """Gliding along X at 1 m/s."""
    ahead = np.arange(start, stop)[:, None, None] / 30 * np.array([1.0, 0.0, 0.0])
    return np.asarray(STANDING_M + ahead)


def lying_still(ticks: int) -> Trace:
    """A body that has fallen at the start, and a bag that rolls."""
    objects = {"bag": np.array([0.0, 0, 0, 1, 0, 0, 0])}
    world = replace(unfelt(objects, ticks), felt=True)
    world.pose_w[:, 0, 0] = np.arange(ticks)
    return Trace(1, np.repeat(STANDING_M[None], ticks, axis=0) * [1, 1, 0.1], np.ones(ticks, dtype=bool), world)


def test_a_task_is_told_the_plan_and_judged_by_the_body_also_when_it_is_taken_up() -> None:
    begin = BodyView(0, STANDING_M, objects={"bag": np.array([0.0, 0, 0, 1, 0, 0, 0])})
    performing = Performing(0, ReachTask(ReachSpec(position_m=(1.0, 0.0)), 0), begin, planned_ahead)
    told = performing.goal(BodyView(30, STANDING_M * [1, 1, 0.1], True), 30)
    assert told.text is not None
    assert "stand" in told.text, "by the plan it is there"
    performing.add(lying_still(60))
    assert performing.status() == "done"
    assert not performing.task.judge(performing.trace()).strict
    back = performing.put_back(performing.state(), ReachTask(ReachSpec(position_m=(1.0, 0.0)), 0), 60)
    assert back.status() == "done"
    earlier = performing.put_back(performing.state(), ReachTask(ReachSpec(position_m=(1.0, 0.0)), 0), 30)
    assert earlier.status() == "running"
