"""Sitting on the floor is the way to lying down, held where it sits."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from planner_service.dip.floor import EASE_FRAMES, HEAD_M, LEAN_RAD, SEATED_M, at_rest, sits_from, upright
from planner_service.dip.planner import DipPlanner
from planner_service.training.rollout import Rollout
from shared.motion.ik import standing_clip
from shared.motion.skeleton import CANONICAL
from shared.tasks.interface import PlanGoal
from shared.tasks.obey import BLOW_TICKS, asks_floor_seat, holds_ticks

HEAD = CANONICAL.index("head")


@pytest.mark.parametrize(
    ("text", "seat"),
    [
        ("a person sits down on the floor.", True),
        ("Sit on the ground", True),
        ("take a seat on the floor", True),
        ("sit down", False),
        ("sit down on the sofa", False),
        ("a person lies down on the floor", False),
        ("stand up from sitting on the floor", False),
        ("get up from the floor", False),
        (None, False),
    ],
)
def test_words_for_sitting_on_the_floor(text: str | None, seat: bool) -> None:
    assert asks_floor_seat(text) == seat
    assert holds_ticks(text) == (BLOW_TICKS if seat else 0)


def test_a_motion_comes_to_rest_where_it_would_lean_back() -> None:
    motion = np.repeat(standing_clip(30, 20.0).positions_w_m, 1, axis=0).astype(np.float64)
    assert sits_from(motion) is None
    motion[:, :, 2] -= motion[:, :1, 2] - 0.15
    motion[:, HEAD, 2] = np.linspace(HEAD_M + 0.15, HEAD_M - 0.15, 30)
    rest = sits_from(motion)
    assert rest is not None
    still = at_rest(motion, rest)
    np.testing.assert_array_equal(still[: rest + 1], motion[: rest + 1])
    assert np.abs(np.diff(still[-3:, HEAD, 2])).max() < 0.1 * np.abs(np.diff(motion[-3:, HEAD, 2])).max()
    assert still[-1, HEAD, 2] > motion[min(rest + EASE_FRAMES, 29), HEAD, 2] - 1e-9


def test_a_trunk_that_leans_back_is_raised_and_legs_stay() -> None:
    motion = np.repeat(standing_clip(1, 20.0).positions_w_m, 30, axis=0).astype(np.float64)
    tip = np.array([[np.cos(0.8), 0.0, -np.sin(0.8)], [0.0, 1.0, 0.0], [np.sin(0.8), 0.0, np.cos(0.8)]])
    back = motion.copy()
    upper = [i for i, name in enumerate(CANONICAL.names) if name.startswith(("spine", "neck", "head"))]
    back[:, upper] = motion[:, :1] + (motion[:, upper] - motion[:, :1]) @ tip.T
    raised = upright(back, 0)
    away = raised[-1, HEAD] - raised[-1, 0]
    assert np.arctan2(-away[0], away[2]) == pytest.approx(LEAN_RAD, abs=0.02)
    legs = CANONICAL.indices("left_knee", "right_ankle", "left_foot")
    np.testing.assert_array_equal(raised[:, legs], back[:, legs])


def test_it_sits_and_stays() -> None:
    torch.set_num_threads(1)
    start = standing_clip(20, 20.0).positions_w_m
    rollout = Rollout(DipPlanner.load(), start[None], seed=1, replan_frames=20)
    while len(rollout.frames(0)) < 160:
        rollout.step(lambda *_: PlanGoal(text="a person sits down on the floor."))
    motion = rollout.frames(0)
    assert (motion[-60:, 0, 2] < SEATED_M).all()
    assert (motion[-60:, HEAD, 2] > 0.5).all()
    assert np.linalg.norm(motion[-1, 0] - motion[-60, 0]) < 0.1
