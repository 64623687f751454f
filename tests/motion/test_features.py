"""G2R and R2G: round trip, meaning of each slice, the frame convention."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from numpy.testing import assert_allclose

from shared.errors import InvalidInputError
from shared.motion import features as ft
from shared.motion.heading import body_heading
from shared.motion.ik import standing_clip
from shared.motion.rotations import matrix_about_z, wrap_angle
from shared.motion.skeleton import CANONICAL
from tests.motion.helpers import random_bodies, seeds, smooth_motion

FPS = 20.0


@given(seeds)
def test_the_round_trip_is_exact(seed: int) -> None:
    """R2G(G2R(x)) < 0.1 mm over three seconds (REFERENCE 4.1)."""
    motion = smooth_motion(np.random.default_rng(seed), 60, FPS)
    state = ft.root_state(motion[0])
    again = ft.features_to_global(ft.global_to_features(motion, FPS), FPS, state)
    assert np.abs(again - motion).max() < 1e-7


@given(seeds)
def test_the_round_trip_holds_for_unrelated_poses(seed: int) -> None:
    motion = random_bodies(np.random.default_rng(seed), 12)
    again = ft.features_to_global(ft.global_to_features(motion, FPS), FPS, ft.root_state(motion[0]))
    assert np.abs(again - motion).max() < 1e-6


@given(seeds)
def test_features_do_not_see_where_the_body_is(seed: int) -> None:
    rng = np.random.default_rng(seed)
    motion = smooth_motion(rng, 20, FPS)
    moved = motion @ matrix_about_z(rng.uniform(-np.pi, np.pi)).T + np.append(rng.uniform(-9, 9, 2), 0.0)
    assert_allclose(ft.global_to_features(moved, FPS), ft.global_to_features(motion, FPS), atol=1e-7)


def _walking_on_a_circle(rate: float, speed: float, frames: int = 30) -> np.ndarray:
    """A stiff body that turns by `rate` rad/s and goes `speed` m/s along its heading, step by step."""
    pose = standing_clip(1, FPS).positions_w_m[0]
    out, xy, heading = [], np.zeros(2), 0.0
    for _ in range(frames):
        out.append(pose @ matrix_about_z(heading).T + np.append(xy, 0.0))
        xy = xy + speed / FPS * np.array([np.cos(heading), np.sin(heading)])
        heading += rate / FPS
    return np.array(out)


@pytest.mark.parametrize("rate", [0.7, -0.7, 20.0])
def test_rates_are_in_si_units_and_in_the_root_frame(rate: float) -> None:
    features = ft.global_to_features(_walking_on_a_circle(rate, 1.3), FPS)
    assert features.shape == (30, ft.FEATURES)
    assert_allclose(features[:, ft.YAW_RATE][:, 0], rate, atol=1e-9)
    assert_allclose(features[:, ft.ROOT_VELOCITY], np.tile([1.3, 0.0], (30, 1)), atol=1e-9)
    assert_allclose(features[:, ft.ROOT_HEIGHT][:, 0], CANONICAL.root_height_m, atol=1e-9)


def test_joint_velocities_are_backward_differences_in_the_root_frame() -> None:
    motion = _walking_on_a_circle(0.0, 1.3) @ matrix_about_z(2.0).T
    velocity = ft.global_to_features(motion, FPS)[:, ft.JOINT_VELOCITIES].reshape(30, 22, 3)
    assert_allclose(velocity, np.broadcast_to([1.3, 0.0, 0.0], velocity.shape), atol=1e-9)


def test_standing_feet_are_in_contact_and_sliding_feet_are_not() -> None:
    assert (ft.global_to_features(standing_clip(5, FPS).positions_w_m, FPS)[:, ft.CONTACTS] == 1).all()
    assert (ft.global_to_features(_walking_on_a_circle(0.0, 1.3), FPS)[:, ft.CONTACTS] == 0).all()


def test_the_slices_cover_all_features_once() -> None:
    parts = [
        ft.YAW_RATE, ft.ROOT_VELOCITY, ft.ROOT_HEIGHT, ft.JOINT_POSITIONS, ft.JOINT_ROTATIONS, ft.JOINT_VELOCITIES,
        ft.CONTACTS,
    ]  # fmt: skip
    covered = np.concatenate([np.arange(ft.FEATURES)[part] for part in parts])
    assert (covered == np.arange(ft.FEATURES)).all()


def test_turning_past_pi_goes_on_turning() -> None:
    """A full turn and more: the yaw rate never jumps and the heading comes back right."""
    motion = _walking_on_a_circle(3.0, 0.5, 90)
    features = ft.global_to_features(motion, FPS)
    assert_allclose(features[:, 0], 3.0, atol=1e-9)
    again = ft.features_to_global(features, FPS, ft.root_state(motion[0]))
    assert_allclose(wrap_angle(body_heading(again) - 3.0 * np.arange(90) / FPS), 0.0, atol=1e-7)


@given(seeds)
def test_points_come_back_from_the_root_frame(seed: int) -> None:
    rng = np.random.default_rng(seed)
    state = ft.RootState(rng.uniform(-5, 5, 2), np.asarray(rng.uniform(-np.pi, np.pi)))
    points = rng.uniform(-5, 5, (7, 3))
    assert_allclose(ft.from_root_frame(ft.to_root_frame(points, state), state), points, atol=1e-12)


def test_a_point_ahead_by_hand() -> None:
    """At (1, 2) facing +Y, the world point (1, 5, 0.5) is three metres ahead."""
    state = ft.RootState(np.array([1.0, 2.0]), np.asarray(np.pi / 2))
    assert_allclose(ft.to_root_frame([[1.0, 5.0, 0.5]], state), [[3.0, 0.0, 0.5]], atol=1e-12)


def test_one_frame_is_refused() -> None:
    with pytest.raises(InvalidInputError) as error:
        ft.global_to_features(standing_clip(1, FPS).positions_w_m, FPS)
    assert error.value.field == "positions_w_m"
