"""Headings: of directions, of hips, of whole bodies."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from shared.motion.body import forward_of, heading_rad
from shared.motion.heading import body_heading, heading_of, hips_heading
from shared.motion.ik import standing_clip
from shared.motion.rotations import matrix_about_z, wrap_angle
from shared.motion.skeleton import CANONICAL

ANGLES = st.floats(-np.pi, np.pi)


@pytest.mark.parametrize(
    ("direction", "angle"),
    [((2.0, 0.0, 5.0), 0.0), ((0.0, 3.0), np.pi / 2), ((-1.0, 0.0, 0.0), np.pi), ((1.0, -1.0), -np.pi / 4)],
)
def test_a_direction_has_the_angle_from_x_to_y(direction: tuple[float, ...], angle: float) -> None:
    assert_allclose(heading_of(direction), angle, atol=1e-12)


@given(ANGLES)
def test_a_body_that_stands_faces_where_it_was_told_to(heading: float) -> None:
    pose = standing_clip(1, 20.0, heading_rad=heading).positions_w_m[0]
    for found in (hips_heading(pose), body_heading(pose), heading_of(forward_of(pose)), heading_rad(pose[None])[0]):
        assert_allclose(wrap_angle(found - heading), 0.0, atol=1e-9)


@given(ANGLES, st.floats(-1.2, 1.2))
def test_hips_do_not_turn_with_the_shoulders_and_a_body_does_by_a_share(heading: float, twist: float) -> None:
    pose = standing_clip(1, 20.0, heading_rad=heading).positions_w_m[0].astype(np.float64)
    shoulders = list(CANONICAL.indices("left_shoulder", "right_shoulder"))
    centre = pose[shoulders].mean(axis=0)
    pose[shoulders] = (pose[shoulders] - centre) @ matrix_about_z(twist).T + centre
    assert_allclose(wrap_angle(hips_heading(pose) - heading), 0.0, atol=1e-9)
    hips = list(CANONICAL.indices("left_hip", "right_hip"))
    hips_m, shoulders_m = (float(np.linalg.norm(np.diff(pose[pair, :2], axis=0))) for pair in (hips, shoulders))
    share = np.arctan2(shoulders_m * np.sin(twist), hips_m + shoulders_m * np.cos(twist))
    assert_allclose(wrap_angle(body_heading(pose) - heading - share), 0.0, atol=1e-6)
