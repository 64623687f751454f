"""Changes of gait go over step on step, and the body leans as the change of speed asks."""

from __future__ import annotations

import numpy as np
import pytest

from shared.data.grounding import ground
from shared.data.label import Label
from shared.data.make_gaits import change_gait, curve, gait, hastened, lean_into, straightened
from shared.data.make_paths import bend_path
from shared.data.pieces import SHORTEST, lengthen
from shared.data.splice import rebuild
from shared.motion.body import J, heading_rad, velocity
from shared.motion.skeleton import CANONICAL
from tests.data.samples import stand, stepping


def test_phases_of_a_walk_follow_its_steps() -> None:
    g = gait(stepping(150))
    assert g is not None
    assert g.last - g.first >= 3.0
    cadence = (g.last - g.first) / float(g.frame_of(g.last) - g.frame_of(g.first))
    assert cadence == pytest.approx(1 / 30, rel=0.03)  # a cycle a second
    assert float(g.phase_of(g.frame_of(1.7))) == pytest.approx(1.7, abs=0.02)
    assert g.step[60:90, 0].mean() * 30 == pytest.approx(1.0, rel=0.02)


def test_a_stand_has_no_phases() -> None:
    assert gait(stand(120)) is None
    assert change_gait(stand(120), 60, stepping(120), 1.0) is None


def test_a_change_of_gait_ramps_the_speed_and_keeps_the_feet_planted() -> None:
    slow, fast = stepping(150, 0.9), stepping(200, 1.6)
    p = change_gait(slow, 45, fast, 1.5)
    assert p is not None
    q, quality = ground(rebuild(p))
    speed = np.convolve(np.diff(q[:, 0, 0]) * 30, np.ones(15) / 15, mode="valid")
    assert speed[:20].mean() == pytest.approx(0.9, abs=0.08)
    assert speed[-30:].mean() == pytest.approx(1.6, abs=0.08)
    steepest = np.abs(np.diff(speed)).max() * 30
    assert steepest < 1.5  # 0.7 m/s in 1.5 s; joined at the nearest pose it would be 2.6 m/s2 and more
    assert quality.skating_mm < 2.0
    assert quality.bone_error_mm < 1e-6
    np.testing.assert_allclose(q[0, :, :2] - q[0, :1, :2], slow[0, :, :2] - slow[0, :1, :2], atol=0.03)


@pytest.mark.parametrize("toward", [(1.0, 0.0), (0.0, -1.0)])
def test_the_lean_brings_the_body_over_the_point_that_pushes_it(toward: tuple[float, float]) -> None:
    p = stand(5)
    wanted = 1.5
    q = lean_into(p, np.repeat([np.array(toward) * wanted], 5, axis=0))
    shift = (q[:, J["spine3"]] - p[:, J["spine3"]])[:, :2] @ np.array(toward)
    height = p[:, J["spine3"], 2]
    np.testing.assert_allclose(shift / height, wanted / np.hypot(wanted, 9.81), rtol=1e-3)
    for foot in ("left_ankle", "right_ankle"):
        np.testing.assert_allclose(q[:, J[foot]], p[:, J[foot]], atol=0.02)
    bones = np.linalg.norm(q - q[:, np.maximum(CANONICAL.parents, 0)], axis=-1)
    np.testing.assert_allclose(bones, np.broadcast_to(CANONICAL.bone_lengths_m, bones.shape), atol=1e-9)


def test_a_curve_leans_to_its_inside_and_is_made_straight_again() -> None:
    p = stepping(150, 1.5)
    left = curve(p, 0.6)
    inside = np.stack([-np.sin(heading_rad(left)), np.cos(heading_rad(left))], axis=-1)
    tilt = np.sum((left[:, J["head"], :2] - left[:, 0, :2]) * inside, axis=-1)
    assert np.degrees(np.arctan2(tilt, left[:, J["head"], 2] - left[:, 0, 2]))[30:-30].mean() == pytest.approx(
        np.degrees(np.arctan(1.5 * 0.6 / 9.81)), abs=1.0
    )
    np.testing.assert_allclose(heading_rad(left), heading_rad(bend_path(p, 0.6)), atol=0.03)
    again = straightened(left)
    assert np.ptp(heading_rad(again)[20:-20]) < 0.12
    over = (again[:, J["head"]] - again[:, 0])[30:-30]
    assert np.abs(np.degrees(np.arctan2(over[:, 1], over[:, 2]))).mean() < 1.5


def test_hastened_motion_is_faster_by_the_factor() -> None:
    p = stepping(120)
    q = hastened(p, 1.25)
    assert len(q) == pytest.approx(96, abs=1)
    assert velocity(q[:, 0], 30.0)[10:-10, 0].mean() == pytest.approx(1.25, rel=0.01)


def test_what_ends_at_speed_is_not_brought_to_rest_at_once() -> None:
    jump = Label("jump", "jump_forward")
    assert lengthen(stepping(60, 2.5), jump) is None
    slow = lengthen(stepping(60, 1.0), jump)
    assert slow is not None
    assert len(slow) >= SHORTEST
    assert lengthen(stand(3), jump) is not None  # even of a few frames
