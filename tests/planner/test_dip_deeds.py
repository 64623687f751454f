"""Deeds are planned for several times, and the plan in which they are done best is taken."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from planner_service.dip.deeds import DEEDS, KICK, PUNCH, WAVE, deed_of, kicking, punching, ranked, tries_of, waving
from planner_service.dip.planner import DipPlanner
from planner_service.text.known import SHIPPED_SENTENCES
from planner_service.text.meaning import MeaningHead
from planner_service.text.pretrained import minilm
from planner_service.training.rollout import Rollout
from shared.motion.features import root_state
from shared.motion.ik import standing_clip
from shared.motion.resampling import finite_velocity
from shared.motion.skeleton import CANONICAL
from shared.protocol.messages import HeadingTarget, JointTarget, PlanRequest
from shared.tasks.interface import PlanGoal
from shared.tasks.kinds import judge
from shared.tasks.obey import BLOW_TICKS, holds_ticks

STANDING = standing_clip(20, 20.0)
MADE_ANEW = {
    "walk", "run", "turn", "wave", "jump", "stand", "sit_down", "pick_up", "get_up", "lie_down", "stretch"
}  # fmt: skip
"""Actions whose plans may be made anew at any time."""


@pytest.fixture(scope="module")
def planner() -> DipPlanner:
    torch.set_num_threads(1)
    return DipPlanner.load()


def request(text: str, **more: object) -> PlanRequest:
    return PlanRequest.model_validate(
        {
            "start_tick": 30,
            "prefix_positions_w_m": STANDING.positions_w_m,
            "prefix_rotations_6d": STANDING.rotations_6d,
            "prefix_velocities_w_mps": finite_velocity(STANDING.positions_w_m, 20),
            "text": text,
            "seed": 5,
            **more,
        }
    )


def test_every_deed_is_of_something_that_the_head_tells_apart_and_its_plans_are_held() -> None:
    encoder = minilm()
    head = MeaningHead.load(encoder.config, encoder.below)
    assert set(DEEDS) <= {name.partition(":")[0] for name in head.names}
    with np.load(SHIPPED_SENTENCES, allow_pickle=False) as known:  # any text is taken for one of them, or is like one
        meant = {
            str(text): {name.partition(":")[0] for name in str(each).split()}
            for text, each in zip(known["sentences"], known["meanings"], strict=True)
        }
    blow = {action for action, deed in DEEDS.items() if deed.lands is not None}
    blows = [text for text, actions in meant.items() if actions & blow]
    assert sum(holds_ticks(text) == BLOW_TICKS for text in blows) > 0.85 * len(blows) > 40
    assert not any(holds_ticks(text) for text, actions in meant.items() if actions and actions <= MADE_ANEW)
    assert holds_ticks(None) == 0


def test_who_says_where_to_be_is_left_alone() -> None:
    assert deed_of("punch_at:left", request("punch")) == (PUNCH, "left")
    assert deed_of("kick_any", request("kick")) == (KICK, "right")
    assert deed_of("walk", request("walk")) is None and deed_of(None, request("kick")) is None
    heading = HeadingTarget(heading_rad=0.0, arrival_tick=60)
    target = JointTarget(joint="left_wrist", position_w_m=(1.0, 0.0, 1.2), arrival_tick=60)
    for more in (
        {"heading": heading},
        {"targets": [target]},
        {"guidance": 0.0},
        {"desired_velocity_w_mps": (1.0, 0.0)},
    ):
        assert deed_of("punch", request("punch", **more)) is None


def test_a_limb_is_sent_ahead_of_the_body_wherever_it_faces() -> None:
    turned = STANDING.positions_w_m[..., [1, 0, 2]] * [-1.0, 1.0, 1.0]  # by 90 degrees to the left
    asked = request("punch with the right hand", prefix_positions_w_m=turned)
    tries = tries_of(asked, root_state(turned[-1]), PUNCH, "right")
    assert len({told.seed for told in tries}) == len(tries) == PUNCH.tries and tries[0].seed == asked.seed
    told = tries[-1]
    assert PUNCH.lands is not None
    assert [target.joint for target in told.targets] == ["right_wrist", "traj"]
    assert told.heading is not None
    x, y = turned[-1, 0, :2]
    np.testing.assert_allclose(told.targets[0].position_w_m, (x, y + PUNCH.lands.ahead_m, PUNCH.lands.up_m), atol=1e-5)
    assert told.heading.heading_rad == pytest.approx(np.pi / 2)
    assert told.targets[0].arrival_tick == asked.start_tick + PUNCH.lands.ticks


def test_plans_are_ranked_by_what_they_show() -> None:
    motions = [np.repeat(STANDING.positions_w_m[-1:].astype(float), 20, axis=0) for _ in range(5)]
    ankle = CANONICAL.index("left_ankle")
    for number, motion in enumerate(motions):
        motion[8:12, ankle] += [0.4, 0.0, 0.1 * ((number * 2) % 5)]
    best_first = ranked(request("kick"), KICK, "left", motions)
    worth = [kicking(motion, "left") for motion in motions]
    assert [worth[i] for i in best_first] == sorted(worth, reverse=True)


def test_a_wave_is_planned_for_as_it_is_and_the_widest_is_the_best() -> None:
    assert deed_of("wave:left", request("wave")) == (WAVE, "left")
    assert deed_of("wave", request("wave")) == (WAVE, "")
    tries = tries_of(request("wave"), root_state(STANDING.positions_w_m[-1]), WAVE, "")
    assert len({told.seed for told in tries}) == WAVE.tries
    assert all(not told.targets and told.heading is None for told in tries)

    def wave(swing_m: float, up_m: float = 0.3) -> np.ndarray:
        motion = np.repeat(STANDING.positions_w_m[-1:].astype(float), 20, axis=0)
        shoulder, wrist = CANONICAL.indices("right_shoulder", "right_wrist")
        motion[:, wrist] = motion[:, shoulder] + [0.1, 0.0, up_m]
        motion[:, wrist, 1] += swing_m * np.sin(np.arange(20) * 2 * np.pi / 10)
        return motion

    assert waving(wave(0.08), "right") > waving(wave(0.02), "right") > waving(wave(0.08), "left")

    def tried(prefix: np.ndarray) -> int:
        asked = request("wave", prefix_positions_w_m=prefix.astype(np.float32))
        return len(tries_of(asked, root_state(prefix[-1]), WAVE, "right"))

    assert tried(wave(0.08)) == WAVE.kept  # it is waving already
    assert tried(wave(0.0)) == WAVE.tries
    assert waving(wave(0.08), "") == waving(wave(0.08), "right")
    assert waving(wave(0.02), "right") > waving(wave(0.08, -0.3), "right")


def test_a_fast_straight_fist_is_worth_more_than_a_slow_or_the_other_one() -> None:
    def thrust(side: str, frames: int) -> np.ndarray:
        motion = np.repeat(STANDING.positions_w_m[-1:].astype(float), 20, axis=0)
        shoulder, wrist = CANONICAL.indices(f"{side}_shoulder", f"{side}_wrist")
        way = np.clip(np.arange(20) / frames, 0, 1)[:, None]
        facing = np.array([np.cos(0.0), 0.0, 0.0])
        motion[:, wrist] = motion[:, shoulder] + (0.1 + 0.4 * way) * facing
        return motion

    fast, slow, other = thrust("left", 4), thrust("left", 16), thrust("right", 4)
    assert punching(fast, "left") > punching(slow, "left")
    assert punching(fast, "left") > punching(other, "left")
    assert punching(other, "right") == pytest.approx(punching(fast, "left"), abs=0.3)


def test_a_calm_kick_is_worth_more_than_a_low_a_hasty_or_a_hopped_one() -> None:
    def lifted(height_m: float, hop_m: float = 0.0, pelvis_mps: float = 0.0) -> np.ndarray:
        motion = np.repeat(STANDING.positions_w_m[-1:].astype(float), 20, axis=0)
        own, other = CANONICAL.indices("right_ankle", "left_ankle")
        motion[8:12, own] += [0.4, 0.0, height_m]
        motion[8:12, other, 2] += hop_m
        motion[..., 0] += (np.arange(20) / 20 * pelvis_mps)[:, None]
        return motion

    good = kicking(lifted(0.4), "right")
    assert good > max(kicking(lifted(0.1), "right"), kicking(lifted(1.0), "right"), kicking(lifted(0.4), "left"))
    assert good > max(kicking(lifted(0.4, hop_m=0.2), "right"), kicking(lifted(0.4, pelvis_mps=1.0), "right"))


@pytest.mark.parametrize(
    ("kind", "text"), [("punch_left", "punch with the left hand"), ("kick_right", "kick it, right foot")]
)
def test_plans_of_blows_show_them(planner: DipPlanner, kind: str, text: str) -> None:
    """Without physics, in each of three runs; most single samples do not (docs/experiments_planner.md)."""
    rollout = Rollout(planner, np.repeat(STANDING.positions_w_m[None], 3, axis=0), 1, 28)
    for _ in range(3):
        rollout.step(lambda body, view: PlanGoal(text=text))
    assert [judge(kind, rollout.trace(body, 20)).done for body in range(3)] == [True] * 3


def test_a_plan_of_several_is_the_same_again_and_has_the_seed_that_was_asked_for(planner: DipPlanner) -> None:
    first, again = planner.plan([request("kick"), request("walk")]), planner.plan([request("kick"), request("walk")])
    assert first[0].seed == 5 and first[0].understood in {
        f"a person kicks with the {s} foot" for s in ("left", "right")
    }
    assert first[1].understood is None
    for one, other in zip(first, again, strict=True):
        np.testing.assert_array_equal(one.positions_w_m, other.positions_w_m)
