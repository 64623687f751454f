"""Rotations from positions: exact round trips, equivariance, mirror symmetry, continuity."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from numpy.testing import assert_allclose

from shared.motion.ik import clip_from_positions, rotations_from_positions, standing_clip
from shared.motion.kinematics import forward_kinematics
from shared.motion.metrics import sole_points
from shared.motion.rotations import matrix_about_z, matrix_from_6d, matrix_from_axis_angle
from shared.motion.skeleton import CANONICAL
from tests.motion.helpers import angle_between, bent_pose, random_bodies, seeds, smooth_motion


@given(seeds)
def test_forward_kinematics_of_the_rotations_gives_the_positions(seed: int) -> None:
    """Whatever the pose, also one that no person can take."""
    positions = random_bodies(np.random.default_rng(seed), 8)
    again, _ = forward_kinematics(CANONICAL, positions[:, 0], rotations_from_positions(positions))
    assert_allclose(again, positions, atol=1e-6)


@given(seeds)
def test_rotations_are_rotations(seed: int) -> None:
    local = rotations_from_positions(random_bodies(np.random.default_rng(seed), 8))
    assert_allclose(local @ np.swapaxes(local, -1, -2), np.broadcast_to(np.eye(3), local.shape), atol=1e-9)
    assert_allclose(np.linalg.det(local), 1.0, atol=1e-9)


@given(seeds)
def test_bent_limbs_give_back_their_twist(seed: int) -> None:
    """Hips, knees, shoulders and elbows come back exactly where the limb bends by 30 degrees or more."""
    local = bent_pose(np.random.default_rng(seed), 8)
    positions, _ = forward_kinematics(CANONICAL, np.zeros((8, 3)), local)
    found = rotations_from_positions(positions)
    joints = [f"{side}_{name}" for side in ("left", "right") for name in ("hip", "knee", "shoulder", "elbow")]
    index = CANONICAL.indices("pelvis", *joints)
    assert angle_between(found[:, index], local[:, index]).max() < 1e-6


@given(seeds)
def test_a_turned_and_shifted_body_has_the_same_joint_rotations(seed: int) -> None:
    rng = np.random.default_rng(seed)
    positions, _ = forward_kinematics(CANONICAL, np.zeros((6, 3)), bent_pose(rng, 6))
    turn = matrix_about_z(rng.uniform(-np.pi, np.pi))
    moved = rotations_from_positions(positions @ turn.T + rng.uniform(-5, 5, 3))
    here = rotations_from_positions(positions)
    assert_allclose(moved[:, 0], turn @ here[:, 0], atol=1e-8)
    assert_allclose(moved[:, 1:], here[:, 1:], atol=1e-8)


@given(seeds)
def test_the_mirrored_body_has_mirrored_rotations(seed: int) -> None:
    positions, _ = forward_kinematics(CANONICAL, np.zeros((6, 3)), bent_pose(np.random.default_rng(seed), 6))
    flip = np.array([1.0, -1.0, 1.0])
    mirrored = rotations_from_positions(positions[:, CANONICAL.mirror_map] * flip)
    expected = rotations_from_positions(positions)[:, CANONICAL.mirror_map] * np.outer(flip, flip)
    assert_allclose(mirrored, expected, atol=1e-7)


@given(seeds)
def test_rebuilt_clips_have_exact_bones(seed: int) -> None:
    rng = np.random.default_rng(seed)
    noisy = smooth_motion(rng, 10, 20.0) + rng.normal(0, 0.02, (10, 22, 3))
    clip = clip_from_positions(noisy, 20.0, rebuild=True)
    bones = clip.positions_w_m[:, 1:] - clip.positions_w_m[:, list(CANONICAL.parents[1:])]
    assert_allclose(np.linalg.norm(bones, axis=-1), np.tile(CANONICAL.bone_lengths_m[1:], (10, 1)), atol=1e-9)
    assert np.abs(clip.positions_w_m - noisy).max() < 0.25


def test_a_limb_that_straightens_does_not_snap() -> None:
    """A twisted leg straightens and bends again by one degree a frame: no joint turns more than six degrees a frame."""
    bend = np.deg2rad(np.abs(np.arange(-60, 61)).astype(float))
    frames = len(bend)
    local = np.broadcast_to(np.eye(3), (frames, 22, 3, 3)).copy()
    local[:, CANONICAL.index("left_hip")] = matrix_about_z(0.5)
    local[:, CANONICAL.index("left_knee")] = matrix_from_axis_angle(np.tile([0.0, 1.0, 0.0], (frames, 1)), bend)
    positions, _ = forward_kinematics(CANONICAL, np.zeros((frames, 3)), local)
    found = rotations_from_positions(positions)
    assert np.rad2deg(angle_between(found[1:], found[:-1]).max()) < 6.0


def test_rotations_of_the_rest_pose_are_none() -> None:
    found = rotations_from_positions(CANONICAL.rest_positions_m[None])
    assert angle_between(found, np.broadcast_to(np.eye(3), found.shape)).max() < 1e-6


def test_standing_is_upright_with_both_soles_on_the_floor() -> None:
    clip = standing_clip(3, 20.0, heading_rad=1.0)
    assert_allclose(sole_points(clip.positions_w_m)[..., 2], 0.0, atol=1e-9)
    head = clip.positions_w_m[:, CANONICAL.index("head")]
    assert (head[:, 2] > 1.4).all()
    assert_allclose(matrix_from_6d(clip.rotations_6d)[:, 0], np.tile(matrix_about_z(1.0), (3, 1, 1)), atol=1e-12)
    wrists = clip.positions_w_m[:, CANONICAL.indices("left_wrist", "right_wrist"), 2]
    assert (wrists < clip.positions_w_m[:, :1, 2]).all()
