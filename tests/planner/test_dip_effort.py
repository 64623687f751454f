"""What is asked of a body before what it was told: a stand, or a slower way."""

from __future__ import annotations

import numpy as np
import pytest

from planner_service.dip.effort import WALK_TEXT, WALKING_MPS, led_up_to
from shared.motion.ik import standing_clip
from shared.protocol.messages import JointTarget, PlanRequest
from shared.text.wording import STAND_TEXT


def request(speed_mps: float, **more: object) -> PlanRequest:
    """Of a body that faces +X and goes along it."""
    clip = standing_clip(20, 20.0)
    way = np.arange(20)[:, None, None] * np.array([speed_mps / 20, 0.0, 0.0])
    return PlanRequest.model_validate(
        {
            "start_tick": 30,
            "prefix_positions_w_m": clip.positions_w_m + way,
            "prefix_rotations_6d": clip.rotations_6d,
            "prefix_velocities_w_mps": np.zeros((20, 22, 3)),
            "text": "as it is",
            "seed": 5,
            **more,
        }
    )


@pytest.mark.parametrize(
    ("meaning", "speed_mps", "stops"),
    [
        ("step_back", 2.5, True),
        ("walk_back", 1.2, True),
        ("step_side:left", 1.2, True),
        ("step_back", 0.3, False),
        ("walk_back", -1.0, False),
        ("jump", 2.5, True),
        ("jump", 0.8, False),
        ("jump_forward", 2.5, False),
        (None, 2.5, False),
    ],
)
def test_who_goes_ahead_stands_before_going_back(meaning: str | None, speed_mps: float, stops: bool) -> None:
    asked = request(speed_mps)
    assert led_up_to(asked, meaning).text == (STAND_TEXT if stops else asked.text)


def test_who_goes_stands_before_sitting_down_on_the_floor() -> None:
    assert led_up_to(request(1.3, text="sit down on the floor"), "sit_down").text == STAND_TEXT
    assert led_up_to(request(0.2, text="sit down on the floor"), "sit_down").text == "sit down on the floor"
    assert led_up_to(request(1.3, text="sit down"), "sit_down").text == "sit down"


@pytest.mark.parametrize(
    ("meaning", "speed_mps", "walks"), [("run", 0.1, True), ("run", 0.9, False), ("walk", 0.1, False)]
)
def test_who_stands_walks_before_running(meaning: str, speed_mps: float, walks: bool) -> None:
    asked = request(speed_mps)
    assert led_up_to(asked, meaning).text == (WALK_TEXT if walks else asked.text)


def test_who_runs_is_told_how_fast_one_walks() -> None:
    told = led_up_to(request(3.0), "walk").desired_velocity_w_mps
    assert told is not None
    np.testing.assert_allclose(told, (WALKING_MPS, 0.0), atol=1e-6)
    assert led_up_to(request(1.5), "walk").desired_velocity_w_mps is None
    assert led_up_to(request(3.0), "run").desired_velocity_w_mps is None


def test_who_says_where_or_how_fast_is_left_alone() -> None:
    target = JointTarget(joint="pelvis", position_w_m=(3.0, 0.0, 0.9), arrival_tick=60)
    for more in ({"targets": [target]}, {"desired_velocity_w_mps": (2.0, 0.0)}, {"guidance": 2.0}):
        asked = request(3.0, **more)
        for meaning in ("walk", "step_back"):
            assert led_up_to(asked, meaning) is asked
