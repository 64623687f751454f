"""Characters of other sizes: what is planned for the canonical skeleton is theirs, and so is what was done."""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.client import Client, ServerProblem
from orchestrator.core.drivers import LockstepDriver
from orchestrator.core.loop import CharacterLoop
from orchestrator.core.services import Services, connect
from orchestrator.core.settings import LOCKSTEP
from orchestrator.core.supervise import Stack
from orchestrator.core.swap import check_drives
from shared.errors import InvalidInputError
from shared.motion.characters import BUILDS, build
from shared.motion.skeleton import CANONICAL
from shared.plugins.interfaces import Planner
from shared.protocol.messages import CreateCharacter, HeadingTarget, JointTarget, Plan, PlanRequest, StateFrame
from shared.tasks.interface import BodyView, Obstacle, PlanGoal
from tests.orchestrator.test_planner_specs import gliding, hosting
from tracker_service.service.service import TrackerService
from tracker_service.service.settings import TrackerServiceSettings


@pytest.fixture(scope="module")
def tracker() -> Iterator[TrackerService]:
    with TrackerService(TrackerServiceSettings(endpoint="tcp://127.0.0.1:0", trackers=("kinematic",))) as running:
        yield running


class Listening:
    """A planner that glides, and remembers what it was asked."""

    def __init__(self) -> None:
        self._inner: Planner = gliding(
            fps=20, prefix_frames=10, plan_frames=40, conditions=("target", "velocity", "keyframes", "obstacles")
        )
        self.spec = self._inner.spec
        self.asked: list[PlanRequest] = []

    def plan(self, requests: list[PlanRequest]) -> list[Plan]:
        self.asked += requests
        return self._inner.plan(requests)


GOAL_M = (0.8, -0.4)


def goal(view: BodyView, plan_tick: int) -> PlanGoal:
    return PlanGoal(
        targets=(JointTarget(joint="traj", position_w_m=(*GOAL_M, 0.0), arrival_tick=max(60, plan_tick + 1)),),
        obstacles=(Obstacle((2.0, 0.0, 1.0), (0.0, 1.0, 0.0), 0.5),),
        keyframe_ticks=(90,),
        keyframe_joints=(("head",),),
        keyframe_positions_w_m=(((0.5, 0.0, 1.0),),),
    )


async def drive(character: str, planner: str, tracker: str) -> tuple[np.ndarray, float]:
    """Joint positions (T, 22, 3) of three seconds under `goal`, and the size the loop sees."""
    services = Services(await connect(planner, "planner"), await connect(tracker, "tracker"))
    loop = CharacterLoop(str(uuid.uuid4()), services, LOCKSTEP, seed=1)
    try:
        start = await loop.ask_tracker(StateFrame, CreateCharacter(character=character))
        driver, sizes = LockstepDriver(loop, start), []

        def noted(view: BodyView, plan_tick: int) -> PlanGoal:
            sizes.append(view.scale)
            return goal(view, plan_tick)

        for _ in range(6):
            cycle = await driver.cycle(noted)
            assert all(plan.accepted for plan in cycle.plans)
        assert loop.last_plan is not None
        assert loop.last_plan.skeleton == build(character).skeleton_id
        return (await loop.trace(0, cycle.state.tick + 1)).pos_w_m, sizes[0]
    finally:
        await services.close()


@pytest.mark.parametrize("name", list(BUILDS))
def test_the_planner_sees_the_canonical_body_and_the_character_keeps_its_own(
    tracker: TrackerService, name: str
) -> None:
    planner, scale = Listening(), build(name).world_scale
    with hosting(planner) as service:
        motion, seen = asyncio.run(drive(name, service.endpoint, tracker.endpoint))
    assert seen == scale
    bones = build(name).skeleton
    np.testing.assert_allclose(motion[:, 0, 2], bones.root_height_m, atol=0.01)
    lengths = np.linalg.norm(motion[-1] - motion[-1, np.maximum(bones.parents, 0)], axis=-1)
    np.testing.assert_allclose(lengths, bones.bone_lengths_m, atol=0.005)
    np.testing.assert_allclose(motion[-1, 0, :2], GOAL_M, atol=0.02)
    assert np.linalg.norm(np.diff(motion[:, 0, :2], axis=0), axis=-1).max() < 0.03, "plan joins plan without a jump"
    for request in planner.asked:
        np.testing.assert_allclose(request.prefix_positions_w_m[:, 0, 2], CANONICAL.root_height_m, atol=0.015)
        (target,) = request.targets
        np.testing.assert_allclose(target.position_w_m[:2], np.array(GOAL_M) / scale, rtol=1e-6)
        np.testing.assert_allclose(request.obstacle_pos_w_m, [[2.0 / scale, 0.0, 1.0 / scale]], rtol=1e-6)
        np.testing.assert_allclose(request.obstacle_radius_m, [0.5 / scale], rtol=1e-6)
        np.testing.assert_allclose(
            request.keyframe_positions_w_m[0, CANONICAL.index("head")], np.array([0.5, 0, 1]) / scale
        )
    under_way = planner.asked[2]
    moved = np.diff(under_way.prefix_positions_w_m[:, 0].astype(np.float64), axis=0) * 20
    np.testing.assert_allclose(under_way.prefix_velocities_w_mps[1:, 0, :2], moved[:, :2], atol=0.05)


@given(factor=st.floats(0.3, 3.0), x=st.floats(-5, 5), speed=st.floats(-2, 2))
def test_a_goal_scales_and_comes_back(factor: float, x: float, speed: float) -> None:
    wanted = PlanGoal(
        text="walk",
        targets=(JointTarget(joint="head", position_w_m=(x, 1.0, 1.5), arrival_tick=30),),
        heading=HeadingTarget(heading_rad=0.5, arrival_tick=30),
        desired_velocity_w_mps=(speed, 0.0),
        facing_rad=1.0,
        obstacles=(Obstacle((x, 0.0, 0.0), (speed, 0.0, 0.0), 0.25),),
        keyframe_ticks=(40,),
        keyframe_joints=(("head",),),
        keyframe_positions_w_m=(((x, 0.0, 1.0),),),
        guidance=2.0,
    )
    there = wanted.scaled(factor)
    assert there.targets[0].position_w_m == (x * factor, factor, 1.5 * factor)
    assert there.desired_velocity_w_mps == (speed * factor, 0.0)
    assert there.obstacles[0].radius_m == 0.25 * factor
    assert there.keyframe_positions_w_m == (((x * factor, 0.0, factor),),)
    same = ("text", "heading", "facing_rad", "keyframe_ticks", "keyframe_joints", "guidance")
    assert all(getattr(there, name) == getattr(wanted, name) for name in same)
    assert there.targets[0].arrival_tick == 30
    back = there.scaled(1 / factor)
    np.testing.assert_allclose(back.targets[0].position_w_m, wanted.targets[0].position_w_m, atol=1e-12)
    assert wanted.scaled(1.0) is wanted


def test_a_tracker_that_does_not_drive_a_character_is_refused_with_those_that_do(tracker: TrackerService) -> None:
    async def check() -> None:
        here = await connect(tracker.endpoint, "tracker")
        try:
            only = {**here.spec("kinematic"), "name": "trained", "characters": ["human"]}
            offered = here.welcome.model_copy(update={"plugins": [*here.welcome.plugins, only]})
            here.client.welcome = offered
            check_drives(here, "kinematic", "child")
            check_drives(here, "trained", "human")
            check_drives(here, None, "child")
            with pytest.raises(InvalidInputError) as caught:
                check_drives(here, "trained", "child")
            assert (caught.value.field, caught.value.allowed) == ("tracker", "kinematic")
        finally:
            await here.client.close()

    asyncio.run(check())


def test_an_unknown_character_is_refused_by_name(stack: Stack) -> None:
    with Client(stack.url) as client, pytest.raises(ServerProblem) as caught:
        client.episode([{"type": "halt"}], character="giant")
    assert caught.value.field == "character"
    assert "child" in (caught.value.allowed or "")


@pytest.mark.parametrize("name", list(BUILDS))
def test_a_character_of_any_size_reaches_a_point_two_metres_away(stack: Stack, name: str) -> None:
    """Recorded walking of the canonical body, performed by `kinematic`, over HTTP."""
    with Client(stack.url) as client:
        there = {"type": "reach", "position_m": (1.6, 1.2)}
        episode = client.episode([there], character=name, planner="clip", tracker="kinematic", seed=1)
        info = episode.wait(timeout_s=120)
        assert info.success, info
        motion = episode.motion()
    end = motion.positions_w_m[-1, 0, :2]
    assert np.linalg.norm(end - [1.6, 1.2]) < 0.3
    assert abs(motion.positions_w_m[0, 0, 2] - build(name).skeleton.root_height_m) < 0.02
