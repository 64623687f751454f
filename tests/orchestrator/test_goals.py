"""From a command or a task to what the planner is asked for: one way for targets, and what it says comes back."""

from __future__ import annotations

import asyncio
import uuid
from math import cos, pi, sin

import numpy as np
import pytest

from orchestrator.client import Client
from orchestrator.core.asking import keyframe_arrays
from orchestrator.core.command import Avoid, Command, CommandGoal, Keyframe, Target
from orchestrator.core.drivers import GoalSource, LockstepDriver
from orchestrator.core.loop import CharacterLoop, plan_seed
from orchestrator.core.services import Services, connect
from orchestrator.core.settings import LOCKSTEP, VARIANTS, LoopSettings
from orchestrator.core.supervise import Stack
from shared.motion.ik import clip_from_positions, standing_clip
from shared.motion.skeleton import CANONICAL
from shared.plugins.interfaces import PlannerSpec
from shared.protocol.messages import CreateCharacter, JointTarget, Plan, PlanRequest, StateFrame
from shared.tasks.approach import Approach
from shared.tasks.builtin import ReachTask
from shared.tasks.interface import BodyView, Obstacle, PlanGoal
from shared.tasks.obey import BLOW_TICKS, asks_low
from shared.tasks.specs import ReachSpec, ReachTuning
from tests.orchestrator.test_planner_specs import hosting
from tracker_service.service.service import TrackerService
from tracker_service.service.settings import TrackerServiceSettings


def planned(request: PlanRequest, positions_w_m: np.ndarray) -> Plan:
    """The plan that goes through these poses."""
    clip = clip_from_positions(positions_w_m, 20, rebuild=True)
    return Plan(
        planner="own",
        start_tick=request.start_tick,
        positions_w_m=clip.positions_w_m,
        rotations_6d=clip.rotations_6d,
    )


class Lying:
    """A planner whose body sinks to the floor within a second, whatever it is told."""

    spec = PlannerSpec(
        name="own", version="1", skeleton=CANONICAL.id, fps=20, prefix_frames=1, plan_frames=40, conditions=("text",)
    )

    def plan(self, requests: list[PlanRequest]) -> list[Plan]:
        return [self._plan(request) for request in requests]

    def _plan(self, request: PlanRequest) -> Plan:
        sunk = np.repeat(request.prefix_positions_w_m[-1:].astype(np.float64), request.horizon_frames, axis=0)
        heights = sunk[0, 0, 2] - np.minimum(np.arange(1, request.horizon_frames + 1) / 20, 1.0)
        sunk[:, :, 2] += (np.maximum(heights, 0.15) - sunk[0, 0, 2])[:, None]
        return planned(request, sunk)


class Wilful(Lying):
    """A planner whose body goes somewhere else for every seed, and that remembers what it was asked."""

    def __init__(self) -> None:
        self.asked: list[int] = []

    def _plan(self, request: PlanRequest) -> Plan:
        self.asked.append(request.seed)
        still = np.repeat(request.prefix_positions_w_m[-1:].astype(np.float64), request.horizon_frames, axis=0)
        still[:, :, 0] += request.seed % 97 / 1000
        return planned(request, still)


async def chosen(planner: str, tracker: str, goal: PlanGoal) -> Plan:
    """The first plan for a goal."""
    services = Services(await connect(planner, "planner"), await connect(tracker, "tracker"))
    loop = CharacterLoop(str(uuid.uuid4()), services, LOCKSTEP, seed=1)
    try:
        state = await loop.ask_tracker(StateFrame, CreateCharacter())
        return await loop.make_plan(goal, state.tick, state.tick)
    finally:
        await services.close()


async def ends_fallen(planner: str, tracker: str, text: str) -> bool:
    """Whether the character counts as fallen after two seconds under a text."""
    services = Services(await connect(planner, "planner"), await connect(tracker, "tracker"))
    loop = CharacterLoop(str(uuid.uuid4()), services, LOCKSTEP, seed=1)
    try:
        start = await loop.ask_tracker(StateFrame, CreateCharacter())
        driver, source = LockstepDriver(loop, start), CommandGoal(Command(text=text), 0)
        for _ in range(4):
            cycle = await driver.cycle(source)
        return cycle.state.fallen
    finally:
        await services.close()


async def plans_within(
    planner: str, tracker: str, source: GoalSource, ticks: int, settings: LoopSettings = LOCKSTEP
) -> int:
    """How many plans are asked for."""
    services = Services(await connect(planner, "planner"), await connect(tracker, "tracker"))
    loop = CharacterLoop(str(uuid.uuid4()), services, settings, seed=1)
    try:
        start = await loop.ask_tracker(StateFrame, CreateCharacter())
        driver = LockstepDriver(loop, start)
        tick = start.tick
        while tick < start.tick + ticks:
            tick = (await driver.cycle(source, start.tick + ticks - tick)).state.tick
        return loop.plans_made
    finally:
        await services.close()


def standing(tick: int = 0, x_m: float = 0.0, scale: float = 1.0) -> BodyView:
    positions = np.asarray(standing_clip(1, 20).positions_w_m[0], dtype=np.float64) * scale + [x_m, 0.0, 0.0]
    return BodyView(tick, positions, scale=scale)


def test_a_way_is_cut_into_steps_and_the_last_arrival_counts_down() -> None:
    """1 m/s, steps of 1.2 m: 3 m away the target is 1.2 m ahead in 1.2 s; from 0.9 m on it is due at one tick."""
    way, goal = Approach("traj", ReachTuning()), np.array([3.0, 0.0])
    far = way.target(np.array([0.0, 0.0]), goal, 0)
    assert (far.position_w_m, far.arrival_tick) == ((1.2, 0.0, 0.0), 36)
    assert way.target(np.array([2.1, 0.0]), goal, 63).arrival_tick == 63 + 27
    assert way.target(np.array([2.4, 0.0]), goal, 72).arrival_tick == 63 + 27, "it counts down"
    assert way.target(np.array([2.9, 0.0]), goal, 87).arrival_tick == 87 + 18, "never sooner than least_arrival_s"
    way.forget()
    assert way.target(np.array([2.4, 0.0]), goal, 72).arrival_tick == 72 + 18


def test_steps_and_speed_grow_with_the_body() -> None:
    target = Approach("traj", ReachTuning()).target(np.zeros(2), np.array([3.0, 0.0]), 0, body_scale=0.5)
    assert (target.position_w_m, target.arrival_tick) == ((0.6, 0.0, 0.0), 36), "half the step in the same time"


@pytest.mark.parametrize("scale", [1.0, 0.7])
def test_a_command_to_a_place_asks_what_the_task_asks(scale: float) -> None:
    view = standing(scale=scale)
    task = ReachTask(ReachSpec(position_m=(2.0, 0.5)), seed=0)
    task.start(view)
    command = CommandGoal(Command(target=Target(position_m=(2.0, 0.5, 0.0))), 0)
    for tick, x_m in ((0, 0.0), (15, 0.6), (30, 1.2), (60, 1.9)):
        now = standing(tick, x_m, scale)
        assert command(now, tick) == task.goal(now, tick)


def test_a_hand_goes_the_same_way() -> None:
    wrist = CANONICAL.index("right_wrist")
    view = standing()
    goal = view.pos_w_m[wrist] + [0.3, 0.0, 0.2]
    command = CommandGoal(Command(target=Target(joint="right_wrist", position_m=tuple(goal))), 0)
    (target,) = command(view, 0).targets
    assert target == Approach("right_wrist", ReachTuning()).target(view.pos_w_m[wrist], goal, 0)
    np.testing.assert_allclose(target.position_w_m, goal)


def test_facing_holds_all_along_where_the_way_goes_elsewhere_and_spheres_move_on() -> None:
    sphere = Avoid(position_m=(2.0, 0.0, 1.0), velocity_mps=(-1.0, 0.0, 0.0), radius_m=0.4)
    strafe = CommandGoal(Command(velocity_mps=(0.0, 1.0), heading_rad=pi / 2, avoid=[sphere]), 30)
    goal = strafe(standing(30), 45)
    assert (goal.facing_rad, goal.desired_velocity_w_mps) == (pi / 2, (0.0, 1.0))
    assert goal.obstacles == (Obstacle((1.5, 0.0, 1.0), (-1.0, 0.0, 0.0), 0.4),), "half a second later"
    turn = CommandGoal(Command(heading_rad=1.0), 0)(standing(), 0)
    assert turn.facing_rad is None
    assert turn.heading is not None


def test_keyframes_count_down_and_hold_joints_by_place_and_by_rotation() -> None:
    quarter = (cos(pi / 4), 0.0, 0.0, sin(pi / 4))
    frames = [
        Keyframe(in_s=0.5, positions_m={"head": (0.0, 0.0, 1.4)}),
        Keyframe(in_s=2.0, positions_m={"left_wrist": (0.3, 0.2, 1.0)}, rotations_wxyz={"pelvis": quarter}),
    ]
    source = CommandGoal(Command(keyframes=frames), 30)
    both = keyframe_arrays(source(standing(30), 30))
    np.testing.assert_array_equal(both["keyframe_ticks"], [45, 90])
    later = keyframe_arrays(source(standing(60), 60))
    np.testing.assert_array_equal(later["keyframe_ticks"], [90])
    wrist, pelvis = CANONICAL.index("left_wrist"), CANONICAL.index("pelvis")
    assert (later["keyframe_mask"].sum(), later["keyframe_mask"][0, wrist]) == (1, 1)
    np.testing.assert_allclose(later["keyframe_positions_w_m"][0, wrist], [0.3, 0.2, 1.0])
    assert (later["keyframe_rotation_mask"].sum(), later["keyframe_rotation_mask"][0, pelvis]) == (1, 1)
    # A quarter turn about Z: the first two columns are Y and -X.
    np.testing.assert_allclose(later["keyframe_rotations_6d"][0, pelvis], [0, 1, 0, -1, 0, 0], atol=1e-7)
    for wrong in ({"in_s": 1.0}, {"in_s": 1.0, "rotations_wxyz": {"tail": quarter}}):
        with pytest.raises(ValueError, match="allowed"):
            Keyframe.model_validate(wrong)


@pytest.mark.parametrize(
    ("text", "low"),
    [
        ("a person sits down.", True), ("someone lies on the floor", True), ("a man crawls forward", True),
        ("a person squats and stands up again", True), ("the person gets up.", True), ("picks something up", True),
        ("a person does push-ups", True), ("a person walks across the floor.", False), ("a person runs", False),
        ("a person is standing still.", False), ("raises both hands up", False), (None, False),
    ],
)  # fmt: skip
def test_words_that_ask_for_being_low(text: str | None, low: bool) -> None:
    assert asks_low(text) is low


@pytest.mark.parametrize(("text", "low"), [("a person sits down.", True), ("a person is standing still.", False)])
def test_the_tracker_is_told_that_being_low_is_asked_for(text: str, low: bool) -> None:
    """A character that is put on the floor by its plan has fallen, unless its text asked for that."""
    with (
        TrackerService(TrackerServiceSettings(endpoint="tcp://127.0.0.1:0", trackers=("kinematic",))) as tracker,
        hosting(Lying()) as planner,
    ):
        assert asyncio.run(ends_fallen(planner.endpoint, tracker.endpoint, text)) is not low


def test_of_several_plans_the_one_that_the_goal_finds_best_is_taken() -> None:
    def ahead_m(positions_w_m: np.ndarray, fps: float) -> float:
        assert fps == 20
        return float(positions_w_m[-1, 0, 0])

    wilful, alone = Wilful(), Wilful()
    with TrackerService(TrackerServiceSettings(endpoint="tcp://127.0.0.1:0", trackers=("kinematic",))) as tracker:
        with hosting(wilful) as planner:
            best = asyncio.run(chosen(planner.endpoint, tracker.endpoint, PlanGoal(candidates=5, worth=ahead_m)))
        with hosting(alone) as planner:
            first = asyncio.run(chosen(planner.endpoint, tracker.endpoint, PlanGoal(candidates=5)))
    assert len(set(wilful.asked)) == 5
    assert alone.asked == [plan_seed(1, 0)]
    assert plan_seed(1, 0) in wilful.asked  # what a goal without candidates gets is among them
    farthest = max(seed % 97 for seed in wilful.asked) / 1000
    assert farthest > plan_seed(1, 0) % 97 / 1000, "choose another seed: the first is the best"
    assert best.positions_w_m[-1, 0, 0] == pytest.approx(farthest, abs=2e-3)
    assert first.positions_w_m[-1, 0, 0] == pytest.approx(plan_seed(1, 0) % 97 / 1000, abs=2e-3)


@pytest.mark.parametrize(("text", "plans"), [("a person walks", 2), ("a person kicks", 1)])
def test_a_blow_is_not_begun_anew_before_it_has_landed(text: str, plans: int) -> None:
    with (
        TrackerService(TrackerServiceSettings(endpoint="tcp://127.0.0.1:0", trackers=("kinematic",))) as tracker,
        hosting(Wilful()) as planner,
    ):
        told = CommandGoal(Command(text=text), 0)
        assert asyncio.run(plans_within(planner.endpoint, tracker.endpoint, told, BLOW_TICKS - 3)) == plans


def test_a_goal_may_want_plans_sooner_but_not_of_loops_that_plan_seldom() -> None:
    ahead = JointTarget(joint="traj", position_w_m=(1.0, 0.0, 0.0), arrival_tick=60)
    usual, soon = PlanGoal(targets=(ahead,)), PlanGoal(targets=(ahead,), replan_ticks=6)
    with (
        TrackerService(TrackerServiceSettings(endpoint="tcp://127.0.0.1:0", trackers=("kinematic",))) as tracker,
        hosting(Wilful()) as planner,
    ):
        made = [
            asyncio.run(plans_within(planner.endpoint, tracker.endpoint, lambda view, tick: goal, 30, settings))  # noqa: B023 - used at once
            for goal, settings in ((usual, LOCKSTEP), (soon, LOCKSTEP), (soon, VARIANTS["paper"]))
        ]
    assert made == [2, 5, 1]


def test_what_the_planner_says_comes_back_with_the_plan(stack: Stack) -> None:
    """`stand` honours nothing: everything asked for is named, and the time it took by parts."""
    with Client(stack.url) as client, client.character(pacing="lockstep", planner="stand") as character:
        character.say(
            "a person walks sideways.", velocity_mps=(0.5, 0.0), heading_rad=1.0,
            avoid=[{"position_m": (2.0, 0.0, 0.0), "radius_m": 0.5}],
        )  # fmt: skip
        character.step(6)
        plan = next(event.data for event in character.events(timeout_s=10) if event.type == "plan")
    assert plan["ignored"] == ["text", "target", "heading", "velocity", "facing", "obstacles"]
    assert plan["guidance"] is None
    assert {"queue", "plan"} <= plan["parts_ms"].keys()
    assert plan["total_ms"] >= plan["parts_ms"]["plan"]
