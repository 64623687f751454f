"""Built-in tasks: goals handed to the planner and verdicts."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from orchestrator.core.command import Command, CommandGoal
from shared.errors import InvalidInputError
from shared.motion.ik import standing_clip
from shared.motion.rotations import matrix_about_z
from shared.tasks.builtin import ReachTask
from shared.tasks.factory import TaskSpec, make_task
from shared.tasks.interface import BodyView, Trace
from shared.tasks.specs import HaltSpec, ReachSpec, TextSpec
from shared.text.wording import STAND_TEXT

STAND = standing_clip(1, 30).positions_w_m[0]


def view(x: float = 0.0, y: float = 0.0, tick: int = 0) -> BodyView:
    return BodyView(tick, STAND + [x, y, 0.0])


def test_a_far_goal_is_approached_in_steps_that_never_come_nearer_in_time() -> None:
    task = make_task(ReachSpec(position_m=(5.0, 0.0)), 0)
    task.start(view())
    for x in (0.0, 0.5, 1.0):
        goal = task.goal(view(x), 300)
        (target,) = goal.targets
        assert target.joint == "traj"
        assert target.position_w_m == pytest.approx((x + 1.2, 0.0, 0.0))
        assert 300 + 12 <= target.arrival_tick <= 300 + 60
        assert goal.heading is not None
        assert goal.heading.heading_rad == pytest.approx(0.0)
        assert goal.text == "a person is walking."


def test_the_last_step_counts_down_across_replans() -> None:
    task = make_task(ReachSpec(position_m=(1.2, 0.0)), 0)
    task.start(view())
    first = task.goal(view(0.0), 0).targets[0]
    second = task.goal(view(0.4), 12).targets[0]
    assert first.position_w_m == second.position_w_m == pytest.approx((1.2, 0.0, 0.0))
    assert first.arrival_tick == second.arrival_tick == 36
    # Once it is too near to be met it is asked for as soon as is possible again.
    assert task.goal(view(0.7), 27).targets[0].arrival_tick >= 27 + 18


def test_near_the_goal_it_stands_and_corrects_a_stop_that_missed() -> None:
    task = make_task(ReachSpec(position_m=(1.0, 0.0)), 0)
    task.start(view())

    def stands(x: float, tick: int) -> bool:
        return task.goal(view(x, tick=tick), tick).text == STAND_TEXT

    assert not stands(0.5, 0)
    assert stands(0.7, 15)
    assert stands(0.6, 30)  # still stopping
    assert not stands(0.6, 45)  # it has come to rest too far away
    assert not stands(0.7, 60)
    assert stands(0.85, 75)
    assert stands(0.8, 300)


def test_random_goals_lie_around_the_character_in_every_direction() -> None:
    places = []
    for seed in range(200):
        task = make_task(ReachSpec(), seed)
        task.start(view(3.0, -2.0))
        assert isinstance(task, ReachTask)
        places.append(task.goal_xy_m - [3.0, -2.0])
    distances = np.linalg.norm(places, axis=1)
    assert 1.0 <= distances.min() < 1.2
    assert 2.8 < distances.max() <= 3.0
    bearings = np.arctan2(*np.transpose(places)[::-1])
    assert np.histogram(bearings, 4, (-pi, pi))[0].min() > 25


def test_a_goal_behind_is_turned_to_before_it_is_walked_to() -> None:
    task = make_task(ReachSpec(position_m=(-2.0, 0.4)), 0)
    task.start(view())
    goal = task.goal(view(), 30)
    assert goal.text == "a person turns to the left."
    assert goal.targets[0].position_w_m == pytest.approx((0.0, 0.0, 0.0))
    assert goal.heading is not None
    assert goal.heading.heading_rad == pytest.approx(np.arctan2(0.4, -2.0))
    # It goes on turning until the bearing is small, and does not turn again for one that is not large.
    for bearing, turns in ((1.0, True), (0.5, False), (1.0, False), (1.3, True)):
        angle = np.arctan2(0.4, -2.0) - bearing
        turned = BodyView(30, np.einsum("ij,kj->ki", matrix_about_z(angle), STAND))
        assert ("turns" in str(task.goal(turned, 60).text)) is turns, bearing


def test_a_relative_goal_turns_with_the_character() -> None:
    task = make_task(ReachSpec(relative_m=(1.0, 0.5)), 0)
    turned = BodyView(0, np.stack([-STAND[:, 1], STAND[:, 0], STAND[:, 2]], axis=-1))
    task.start(turned)
    assert isinstance(task, ReachTask)
    assert task.goal_xy_m == pytest.approx([-0.5, 1.0])


def test_halt_holds_the_spot_where_the_body_came_to_rest() -> None:
    task = make_task(HaltSpec(), 0)
    task.start(view())
    assert all(task.goal(view(0.6 * k, tick=15 * k), 15 * k).targets == () for k in range(3))
    resting = task.goal(view(1.25, tick=45), 45)
    assert resting.targets[0].position_w_m == pytest.approx((1.25, 0.0, 0.0))
    assert resting.heading is not None
    pushed = task.goal(view(1.6, tick=60), 60)
    assert pushed.targets[0].position_w_m == pytest.approx((1.25, 0.0, 0.0))


def test_halt_judges_the_drift_after_the_stopping_time() -> None:
    task = make_task(HaltSpec(settle_s=1.0, duration_s=2.0), 0)
    task.start(view())
    positions = np.repeat(STAND[None], 120, axis=0)
    positions[:30, :, 0] += np.linspace(-1, 0, 30)[:, None]
    done = Trace(1, positions, np.zeros(120, dtype=bool))
    assert task.status(Trace(1, positions[:80], done.fallen[:80])) == "running"
    assert task.status(done) == "done"
    assert task.judge(done).strict
    positions[100:, :, 0] += 0.3
    assert not task.judge(done).strict


def test_text_is_judged_within_its_duration_and_falls_until_the_end() -> None:
    task = make_task(TextSpec(text="walk", duration_s=2.0), 0)
    positions = np.repeat(STAND[None], 90, axis=0)
    positions[:60, :, 0] += np.linspace(0, 2, 60)[:, None]
    fallen = np.zeros(90, dtype=bool)
    assert task.judge(Trace(1, positions, fallen)).strict
    fallen[80] = True
    verdict = task.judge(Trace(1, positions, fallen))
    assert (verdict.strict, verdict.code, verdict.fell) == (False, True, True)


@pytest.mark.parametrize(
    ("spec", "field"),
    [
        ({"type": "reach", "time_limit_s": -1}, "time_limit_s"),
        ({"type": "reach", "position_m": [float("nan"), 0]}, "position_m"),
        ({"type": "text", "text": "x" * 10_000}, "text"),
        ({"type": "text", "text": ""}, "text"),
        ({"type": "halt", "duration_s": 0}, "duration_s"),
        ({"type": "reach", "position_m": [0, 0], "relative_m": [0, 0]}, "reach"),
    ],
)
def test_bad_specs_name_the_field(spec: dict[str, object], field: str) -> None:
    with pytest.raises(ValidationError) as caught:
        TypeAdapter(TaskSpec).validate_python(spec)
    assert any(field in map(str, error["loc"]) for error in caught.value.errors())


def test_a_wrist_target_counts_down_and_lands() -> None:
    command = Command.model_validate({"target": {"joint": "right_wrist", "position_m": [0.4, -0.3, 1.2]}})
    source = CommandGoal(command, 0)
    arrivals = [source(view(tick=tick), tick).targets[0].arrival_tick for tick in (0, 6, 12)]
    assert arrivals[0] == arrivals[1] or arrivals[1] == 6 + 18
    assert arrivals == sorted(arrivals)


def test_a_target_out_of_reach_is_refused() -> None:
    command = Command.model_validate({"target": {"position_m": [30.0, 30.0, 0.0]}})
    with pytest.raises(InvalidInputError) as caught:
        command.check_reachable(view())
    assert caught.value.field == "target.position_m"
    assert caught.value.allowed == "within 30 m"
    command.check_reachable(view(20.0, 20.0))


def test_velocity_becomes_a_place_ahead_and_a_heading() -> None:
    goal = CommandGoal(Command(velocity_mps=(0.0, 1.0)), 0)(view(1.0, 2.0), 30)
    assert goal.desired_velocity_w_mps == (0.0, 1.0)
    assert goal.targets[0].position_w_m == pytest.approx((1.0, 3.0, 0.0))
    assert goal.heading is not None
    assert goal.heading.heading_rad == pytest.approx(pi / 2)


def test_keyframes_pass_with_time() -> None:
    command = Command.model_validate({"keyframes": [{"in_s": 1.0, "positions_m": {"head": [0, 0, 1.2]}}]})
    source = CommandGoal(command, 30)
    assert source(view(), 30).keyframe_ticks == (60,)
    assert source(view(), 60).keyframe_ticks == ()
