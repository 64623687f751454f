"""Plans whose sampling goes by what the text means."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from planner_service.dip.deeds import DEEDS
from planner_service.dip.effort import EASIER_GUIDANCE
from planner_service.dip.manner import ARMS, FIRM, LIVELY_MPS, LIVELY_SWING, MANNERS, Manner, manner_of, swung
from planner_service.dip.planner import DipPlanner
from planner_service.text.meaning import MeaningHead
from planner_service.text.pretrained import minilm
from planner_service.training.rollout import Rollout
from shared.data.texts import SENTENCES
from shared.motion.features import FEATURES, JOINT_POSITIONS, JOINT_VELOCITIES
from shared.motion.ik import standing_clip
from shared.motion.resampling import finite_velocity
from shared.motion.skeleton import CANONICAL
from shared.protocol.messages import PlanRequest
from shared.tasks.interface import PlanGoal

USUAL = Manner(3.0, 2.5)


@pytest.fixture(scope="module")
def planner() -> DipPlanner:
    torch.set_num_threads(1)
    return DipPlanner.load()


def test_every_manner_is_of_something_that_the_head_tells_apart() -> None:
    encoder = minilm()
    head = MeaningHead.load(encoder.config, encoder.below)
    assert set(MANNERS) <= {name.partition(":")[0] for name in head.names} <= set(SENTENCES)
    assert manner_of("step_side:left", USUAL) == FIRM
    assert manner_of("walk", USUAL) == manner_of(None, USUAL) == USUAL
    assert set(LIVELY_MPS) <= {name.partition(":")[0] for name in head.names} - set(MANNERS) - set(DEEDS)


def test_who_dances_too_slowly_swings_more() -> None:
    manner = manner_of("dance", USUAL)
    still = standing_clip(20, 20.0).positions_w_m
    assert (manner.guidance, manner.after(still).swing) == (USUAL.guidance, LIVELY_SWING)
    up = still + np.array([0.0, 0.0, 0.5 * LIVELY_MPS["dance"] / 20]) * np.arange(20)[:, None, None]
    assert manner.after(up).swing == pytest.approx(LIVELY_SWING / 2)
    assert manner.after(still + 4 * (up - still)).swing == 0.0
    assert manner_of("wave", USUAL).after(still) == manner_of("wave", USUAL)


def test_what_is_quicker_than_a_swing_is_left_out_of_lively_plans() -> None:
    frame = torch.arange(40)
    wrist = JOINT_POSITIONS.start + 3 * (ARMS[1] - 1)
    plans = torch.zeros(2, 40, FEATURES)
    plans[:, :, wrist] = 0.1 * torch.sin(2 * torch.pi * frame / 20) + 0.02 * (-1.0) ** frame
    out = swung(plans, torch.zeros(2), torch.tensor([1.0, 0.0]))
    torch.testing.assert_close(out[1], plans[1])
    second = [torch.diff(plan[10:30, wrist], n=2).abs().max() for plan in (out[0], plans[0])]
    assert second[0] < 0.15 * second[1]
    assert out[0, 10:30, wrist].max() > 0.085


def test_arms_swing_more_about_where_they_are_and_nothing_else_is_touched() -> None:
    time = torch.arange(40) / 20
    wave = 0.1 * torch.sin(2 * torch.pi * 2 * time)
    plans = torch.ones(2, 40, FEATURES)
    wrist = JOINT_POSITIONS.start + 3 * (ARMS[1] - 1)
    plans[:, :, wrist] += wave
    out = swung(plans, torch.tensor([0.5, 0.0]))
    torch.testing.assert_close(out[1], plans[1])
    middle = slice(10, 30)  # at the ends its mean is one-sided
    torch.testing.assert_close(out[0, middle, wrist], 1 + 1.5 * wave[middle], atol=0.01, rtol=0)
    arms = [JOINT_POSITIONS.start + 3 * (j - 1) + k for j in ARMS for k in range(3)]
    arms += [JOINT_VELOCITIES.start + 3 * j + k for j in ARMS for k in range(3)]
    others = [i for i in range(FEATURES) if i not in arms]
    torch.testing.assert_close(out[..., others], plans[..., others])


@pytest.mark.parametrize(
    ("text", "asked", "guidance", "taken"),
    [
        ("kick it with your left foot", None, 1.0, "left"),
        ("kick it with your left foot", 2.0, 2.0, "left"),
        ("one step aside to your right", None, 7.0, "right"),
        ("a person walks", None, 3.0, None),
        ("a person waves with the left hand", None, 1.0, None),
    ],
)
def test_a_plan_says_what_it_was_made_for(
    planner: DipPlanner, text: str, asked: float | None, guidance: float, taken: str | None
) -> None:
    prefix = standing_clip(20, 20.0)
    request = PlanRequest(
        start_tick=0,
        prefix_positions_w_m=prefix.positions_w_m,
        prefix_rotations_6d=prefix.rotations_6d,
        prefix_velocities_w_mps=finite_velocity(prefix.positions_w_m, 20),
        text=text,
        guidance=asked,
    )
    (plan,) = planner.plan([request])
    assert plan.guidance == guidance
    assert (plan.understood is None) if taken is None else (taken in str(plan.understood))


def test_a_walker_comes_to_a_stand_first(planner: DipPlanner) -> None:
    moving = standing_clip(20, 20.0)
    positions = moving.positions_w_m + np.arange(20)[:, None, None] / 20 * [1.1, 0.0, 0.0]
    request = PlanRequest(
        start_tick=0,
        prefix_positions_w_m=positions,
        prefix_rotations_6d=moving.rotations_6d,
        prefix_velocities_w_mps=finite_velocity(positions, 20),
        text="a person waves with the left hand",
    )
    assert planner.plan([request])[0].guidance in (3.0, EASIER_GUIDANCE)


def test_waves_swing_as_far_as_one_sees(planner: DipPlanner) -> None:
    texts = [f"a person waves with the {side} hand." for side in ("left", "right") for _ in range(3)]
    start = np.repeat(standing_clip(20, 20.0).positions_w_m[None], len(texts), axis=0)
    rollout = Rollout(planner, start, seed=3)
    for _ in range(3):
        rollout.step(lambda body, view: PlanGoal(text=texts[body]))
    swings = []
    for body, text in enumerate(texts):
        side = "left" if "left" in text else "right"
        shoulder, wrist = CANONICAL.indices(f"{side}_shoulder", f"{side}_wrist")
        hand = (rollout.frames(body)[:, wrist] - rollout.frames(body)[:, shoulder])[60:]
        swings += [float(np.ptp(hand[i : i + 20], axis=0).max()) for i in range(0, len(hand) - 19, 10)]
    assert np.median(swings) >= 0.12
