"""The skeleton as data, the clip's checks and forward kinematics."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from numpy.testing import assert_allclose

from shared.errors import InvalidInputError
from shared.motion.clip import MotionClip
from shared.motion.kinematics import forward_kinematics, local_from_global
from shared.motion.rotations import matrix_about_z, matrix_to_6d
from shared.motion.skeleton import CANONICAL, Skeleton, skeleton
from tests.motion.helpers import random_matrices, seeds


def test_names_and_order_are_those_of_humanml3d() -> None:
    assert CANONICAL.names == (
        "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle", "right_ankle",
        "spine3", "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head", "left_shoulder",
        "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist",
    )  # fmt: skip


def test_the_body_has_two_equal_sides() -> None:
    mirror = CANONICAL.mirror_map
    assert (mirror[mirror] == np.arange(len(CANONICAL))).all()
    assert_allclose(CANONICAL.offsets_m[mirror] * [1.0, -1.0, 1.0], CANONICAL.offsets_m, atol=0)
    assert all(CANONICAL.parents[mirror[j]] == mirror[p] for j, p in enumerate(CANONICAL.parents) if p >= 0)


def test_proportions_are_a_persons() -> None:
    """1.75 m tall: ankles at .039 H, knees at .285 H, hips at .530 H (Winter); head joint below the crown."""
    z = dict(zip(CANONICAL.names, CANONICAL.rest_positions_m[:, 2] / CANONICAL.height_m, strict=True))
    assert z["left_ankle"] == pytest.approx(0.039, abs=0.002)
    assert z["left_knee"] == pytest.approx(0.285, abs=0.005)
    assert z["left_hip"] == pytest.approx(0.530, abs=0.005)
    assert 0.85 < z["head"] < 0.95
    assert z["left_shoulder"] == pytest.approx(0.818, abs=0.02)


def test_unknown_joints_and_skeletons_are_named() -> None:
    with pytest.raises(InvalidInputError) as joint:
        CANONICAL.index("tail")
    assert joint.value.field == "joint"
    assert "left_wrist" in str(joint.value.allowed)
    with pytest.raises(InvalidInputError) as unknown:
        skeleton("horse")
    assert CANONICAL.id in str(unknown.value.allowed)


def test_a_child_before_its_parent_is_refused() -> None:
    with pytest.raises(InvalidInputError):
        Skeleton("bad", ("a", "b"), (1, -1), np.zeros((2, 3)), 1.0, 1.0)


def test_no_rotation_is_the_rest_pose() -> None:
    local = np.broadcast_to(np.eye(3), (22, 3, 3))
    positions, world = forward_kinematics(CANONICAL, [0.0, 0.0, CANONICAL.root_height_m], local)
    assert_allclose(positions, CANONICAL.rest_positions_m, atol=1e-12)
    assert_allclose(world, local, atol=0)


def test_a_raised_forearm_by_hand() -> None:
    """The left elbow bent by a quarter turn about -Z: the wrist comes to lie forearm's length ahead of the elbow."""
    local = np.broadcast_to(np.eye(3), (22, 3, 3)).copy()
    local[CANONICAL.index("left_elbow")] = matrix_about_z(-np.pi / 2)
    positions, _ = forward_kinematics(CANONICAL, np.zeros(3), local)
    elbow, wrist = positions[CANONICAL.indices("left_elbow", "left_wrist")]
    assert_allclose(wrist - elbow, [CANONICAL.bone_lengths_m[CANONICAL.index("left_wrist")], 0.0, 0.0], atol=1e-12)


@given(seeds)
def test_bones_keep_their_lengths(seed: int) -> None:
    rng = np.random.default_rng(seed)
    positions, _ = forward_kinematics(CANONICAL, rng.standard_normal((4, 3)), random_matrices(rng, 4, 22))
    bones = positions[:, 1:] - positions[:, list(CANONICAL.parents[1:])]
    assert_allclose(np.linalg.norm(bones, axis=-1), np.tile(CANONICAL.bone_lengths_m[1:], (4, 1)), atol=1e-12)


@given(seeds)
def test_local_and_world_rotations_invert_each_other(seed: int) -> None:
    rng = np.random.default_rng(seed)
    local = random_matrices(rng, 2, 3, 22)
    _, world = forward_kinematics(CANONICAL, np.zeros((2, 3, 3)), local)
    assert_allclose(local_from_global(CANONICAL, world), local, atol=1e-12)


def _clip_parts() -> tuple[np.ndarray, np.ndarray]:
    return (
        np.broadcast_to(CANONICAL.rest_positions_m, (5, 22, 3)).copy(),
        matrix_to_6d(np.broadcast_to(np.eye(3), (5, 22, 3, 3))),
    )


def test_a_clip_knows_its_duration_and_root() -> None:
    positions, rotations = _clip_parts()
    clip = MotionClip(positions, rotations, 20.0)
    assert len(clip) == 5
    assert clip.duration_s == pytest.approx(0.2)
    assert_allclose(clip.root_quat_w, np.tile([1.0, 0.0, 0.0, 0.0], (5, 1)), atol=0)
    assert len(clip.slice(1, 3)) == 2
    assert clip.slice(1, 3).fps == 20.0


@pytest.mark.parametrize("case", ["joints", "rotations", "rate", "nan", "skeleton"])
def test_an_unfit_clip_is_refused_by_field(case: str) -> None:
    positions, rotations = _clip_parts()
    fps, skeleton_id, field = 20.0, CANONICAL.id, "positions_w_m"
    if case == "joints":
        positions = positions[:, :21]
    elif case == "rotations":
        rotations, field = rotations[:4], "rotations_6d"
    elif case == "rate":
        fps, field = 0.0, "fps"
    elif case == "nan":
        positions[0, 0, 0] = np.nan
    else:
        skeleton_id, field = "horse", "skeleton"
    with pytest.raises(InvalidInputError) as error:
        MotionClip(positions, rotations, fps, skeleton_id)
    assert error.value.field == field
