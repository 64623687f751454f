"""Who is down stays down until it stands: on its knees nobody else takes it over."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from orchestrator.core.on_fall import Down, get_up_goal
from shared.motion.ik import standing_clip
from shared.tasks.interface import RISE_PLANNER, BodyView

STAND = standing_clip(2, 30.0).positions_w_m[0].astype(np.float64)


def view(height_m: float, fallen: bool, scale: float = 1.0) -> BodyView:
    pose = STAND * scale
    pose[:, 2] += height_m - pose[0, 2]
    return BodyView(0, pose, fallen, scale)


def test_down_from_the_fall_until_standing() -> None:
    down = Down()
    assert not down.update(view(0.95, False))
    assert not down.update(view(0.5, False))  # a squat is no fall
    assert down.update(view(0.2, True))
    assert down.update(view(0.5, False))  # on its knees
    assert not down.update(view(0.9, False))
    assert not down.update(view(0.5, False))
    down.update(view(0.2, True))
    down.clear()
    assert not down.update(view(0.5, False))


def test_a_child_stands_lower() -> None:
    down = Down()
    down.update(view(0.2, True, 0.69))
    assert not down.update(view(0.62, False, 0.69))


def test_getting_up_asks_for_its_own_planner_and_lying_is_still_a_fall() -> None:
    goal = get_up_goal()
    assert goal.planner == RISE_PLANNER and goal.may_be_low is False


def test_who_lies_for_long_is_known() -> None:
    down = Down()
    down.update(replace(view(0.2, True), tick=100))
    assert not down.too_long(100 + 600)
    down.update(replace(view(0.2, True), tick=400))
    assert down.too_long(100 + 601)
    down.clear()
    assert not down.too_long(5000)
