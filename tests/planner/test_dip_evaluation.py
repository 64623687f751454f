"""The kinematic closed loop and what counts as showing a text."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from planner_service.builtin.stand import StandPlanner
from planner_service.training.dataset import WindowSampler, load_material
from planner_service.training.evaluate_conditions import KEYED, conditions
from planner_service.training.evaluate_loop import reach
from planner_service.training.evaluate_quality import contact_slide_mm
from planner_service.training.evidence import deed_ahead, frames_showing, plans_showing
from planner_service.training.rollout import Rollout
from planner_service.training.windows import window_positions
from shared.data.corpus import Corpus
from shared.errors import InvalidInputError
from shared.motion.features import global_to_features
from shared.motion.ik import standing_clip
from shared.motion.skeleton import CANONICAL
from shared.plugins.interfaces import PlannerSpec
from shared.protocol.messages import Plan, PlanRequest
from shared.tasks.interface import BodyView, PlanGoal
from tests.planner.dip_helpers import moving_body, write_small_corpus

STANDING = standing_clip(20, 20).positions_w_m


def test_rollout_plays_what_was_planned_and_asks_from_its_end() -> None:
    planner = StandPlanner()
    start = np.stack([STANDING, STANDING + [2.0, 1.0, 0.0]])
    rollout = Rollout(planner, start, seed=0)
    seen: list[tuple[int, int]] = []

    def goal(body: int, view: BodyView) -> PlanGoal:
        seen.append((body, view.tick))
        np.testing.assert_array_equal(view.pos_w_m, rollout.frames(body)[-1])
        return PlanGoal(text="a person is standing still.")

    rollout.step(goal)
    rollout.step(goal)
    assert seen == [(0, 0), (1, 0), (0, 30), (1, 30)]
    assert list(rollout.lengths()) == [60, 60]
    assert rollout.tick == 60
    assert len(rollout.trace(0, 19)) == 61
    np.testing.assert_allclose(rollout.frames(1)[-1, 0, :2], [2.0, 1.0], atol=0.05)


def test_odd_replan_is_refused() -> None:
    with pytest.raises(InvalidInputError) as caught:
        Rollout(StandPlanner(), STANDING[None], seed=0, replan_frames=15)
    assert caught.value.field == "replan_frames"


def test_who_stands_reaches_nothing() -> None:
    result = reach(StandPlanner(), episodes=3, seed=0, seconds=2)
    assert result["reached"] == 0.0
    assert result["median_time_s"] is None


def test_slide_is_the_way_of_touching_feet() -> None:
    still = np.repeat(STANDING[:1], 30, 0)
    assert contact_slide_mm(still) == 0.0
    slid = still + np.arange(30)[:, None, None] * [0.004, 0.0, 0.0]
    assert abs(contact_slide_mm(slid) - 4.0) < 1e-6


def test_jump_shows_only_where_both_feet_are_up() -> None:
    motion = np.repeat(STANDING[:1], 60, 0)
    motion[40:50, :, 2] += 0.2
    features = global_to_features(motion, 20).astype(np.float32)
    # Heights in the features are above the floor, so the lift is seen in them.
    assert frames_showing(features, "jump").nonzero()[0].tolist() == list(range(40, 50))
    ahead = deed_ahead(features, "jump", 20)
    assert not ahead[:22].any()
    assert ahead[22:49].all()
    assert not ahead[49:].any()


def test_wave_turn_and_the_rest() -> None:
    arm_up = np.repeat(STANDING[:1], 40, 0)
    arm_up[:, CANONICAL.index("right_wrist"), 2] = 1.7
    turning = moving_body(41, 20.0, 0.0, 1.0)[1:]
    motions = (arm_up, STANDING.repeat(2, 0), turning, arm_up, turning)
    plans = np.stack([global_to_features(m, 20).astype(np.float32) for m in motions])
    shown = plans_showing(plans, ["wave", "wave", "turn", "turn", "stand"])
    assert shown.tolist() == [True, False, True, False, True]


def test_standing_is_not_walking_and_walking_is_not_running() -> None:
    walking = moving_body(41, 20.0, 1.0, 0.0)[1:]
    late = np.concatenate([np.repeat(walking[:1], 25, 0), walking[:15]])
    plans = np.stack(
        [global_to_features(m, 20).astype(np.float32) for m in (walking, STANDING.repeat(2, 0), late, walking)]
    )
    assert plans_showing(plans, ["walk", "walk", "walk", "run"]).tolist() == [True, False, False, False]


class Recalling(StandPlanner):
    """Gives back what held-out windows went on to do, moved by `slip`, if asked for something of the kind."""

    def __init__(self, windows: np.ndarray, takes: tuple[str, ...], slip: np.ndarray) -> None:
        self._windows, self._takes, self._slip = windows, takes, slip

    @property
    def spec(self) -> PlannerSpec:
        return StandPlanner().spec.model_copy(
            update={"prefix_frames": 20, "plan_frames": 40, "conditions": ("text", *self._takes)}
        )

    def plan(self, requests: list[PlanRequest]) -> list[Plan]:
        stood = StandPlanner().plan(requests)
        out = []
        for request, plan in zip(requests, stood, strict=True):
            asked = request.keyframe_mask.any() or request.desired_velocity_w_mps is not None
            going = self._windows[request.seed - 1, 20:] + self._slip
            out.append(plan.model_copy(update={"positions_w_m": going}) if asked else plan)
        return out


def test_errors_of_keyframes_and_velocities_are_those_of_the_plans(tmp_path: Path) -> None:
    """Plans 3 cm off everywhere keep the velocity; plans that drift by 1 cm a frame are 0.2 m/s off."""
    material = load_material(Corpus.load(write_small_corpus(tmp_path / "v")), "heldout", 60)
    windows = window_positions(WindowSampler(material, 20, 40, 1, augment=False).draw(14).features.numpy())
    both = ("velocity", "keyframes")
    beside = conditions(Recalling(windows, both, np.array([0.0, 0.0, 0.03])), material, 14, 1)
    assert abs(beside["keyframe_error_m"] - 0.03) < 1e-5
    assert set(beside["keyframe_error_by_joint_m"]) == set(KEYED)
    assert beside["velocity_error_mps"] < 1e-4
    drift = np.arange(1, 41)[:, None, None] * [0.0, 0.01, 0.0]
    drifting = conditions(Recalling(windows, both, drift), material, 14, 1)
    assert abs(drifting["velocity_error_mps"] - 0.2) < 1e-4
    assert 0.1 <= drifting["keyframe_error_m"] <= 0.4 + 1e-6, "keys are due at frames 10 to 40"
    assert set(conditions(Recalling(windows, ("velocity",), drift), material, 14, 1)) == {"velocity_error_mps"}
    assert conditions(Recalling(windows, (), drift), material, 14, 1) == {}
