"""Ways up begin in the pose a body lies in and end standing, wherever and however it lies."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shared.errors import InvalidInputError
from shared.motion.ik import standing_clip
from shared.motion.kinematics import forward_kinematics
from shared.motion.rise import Rises, between
from shared.motion.rotations import matrix_about_z, matrix_from_rotvec
from shared.motion.skeleton import CANONICAL

STAND = standing_clip(2, 30.0).positions_w_m[0].astype(np.float64)


def lying(face_up: bool = True) -> np.ndarray:
    local = np.repeat(np.eye(3)[None], len(CANONICAL), 0)
    local[0] = matrix_from_rotvec(np.array([0.0, -np.pi / 2 if face_up else np.pi / 2, 0.0]))
    return np.asarray(forward_kinematics(CANONICAL, np.array([[0.0, 0.0, 0.16]]), local[None])[0][0])


def get_up(face_up: bool) -> np.ndarray:
    share = np.linspace(0.0, 1.0, 60)
    return between(lying(face_up), STAND, share, CANONICAL)


def placed(pose: np.ndarray, yaw: float, x: float, y: float) -> np.ndarray:
    return np.asarray(pose @ matrix_about_z(yaw).T + np.array([x, y, 0.0]))


@settings(max_examples=20, deadline=None)
@given(st.floats(-3.1, 3.1), st.floats(-5, 5), st.floats(-5, 5), st.booleans())
def test_a_way_up_begins_at_the_pose_and_ends_standing_there(yaw: float, x: float, y: float, up: bool) -> None:
    rises = Rises([get_up(True), get_up(False)], 30.0, CANONICAL)
    pose = placed(lying(up), yaw, x, y)
    entry = rises.nearest(pose)
    assert entry.number == (0 if up else 1)
    assert entry.distance_m < 0.02
    way = rises.rise(pose)
    np.testing.assert_allclose(way[0], pose, atol=2e-3)
    assert way[-1, 0, 2] == pytest.approx(STAND[0, 2], abs=1e-6)
    # It does not go anywhere: the end is where the get-up, brought to the body, leads.
    assert np.linalg.norm(way[-1, 0, :2] - pose[0, :2]) < 1.2
    assert way[..., 2].min() > -0.01
    step = np.linalg.norm(np.diff(way, axis=0), axis=-1).max()
    assert step < 0.12


def test_what_lies_between_a_far_pose_and_the_entry_takes_longer() -> None:
    rises = Rises([get_up(True)], 30.0, CANONICAL)
    near, far = rises.rise(lying(True)), rises.rise(lying(False))
    assert len(far) > len(near)


def test_standing_motions_alone_are_refused() -> None:
    with pytest.raises(InvalidInputError, match="low pose"):
        Rises([np.repeat(STAND[None], 5, 0)], 30.0, CANONICAL)
