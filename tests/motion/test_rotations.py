"""Rotations: group axioms, agreement of the three forms, hand-computed cases."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from shared.motion import rotations as rot
from tests.motion.helpers import angle_between, random_matrices, random_quats, seeds

TIGHT = 1e-12


@given(seeds)
def test_quaternions_form_a_group(seed: int) -> None:
    a, b, c = random_quats(np.random.default_rng(seed), 3, 8)
    one = np.array([1.0, 0.0, 0.0, 0.0])
    assert_allclose(rot.quat_mul(rot.quat_mul(a, b), c), rot.quat_mul(a, rot.quat_mul(b, c)), atol=TIGHT)
    assert_allclose(rot.quat_mul(a, one), a, atol=TIGHT)
    assert_allclose(rot.quat_mul(one, a), a, atol=TIGHT)
    assert_allclose(rot.quat_mul(a, rot.quat_conj(a)), np.broadcast_to(one, a.shape), atol=TIGHT)
    assert_allclose(np.linalg.norm(rot.quat_mul(a, b), axis=-1), 1.0, atol=TIGHT)


@given(seeds)
def test_matrices_are_rotations_and_respect_products(seed: int) -> None:
    a, b = random_quats(np.random.default_rng(seed), 2, 8)
    m = rot.matrix_from_quat(a)
    assert_allclose(m @ np.swapaxes(m, -1, -2), np.broadcast_to(np.eye(3), m.shape), atol=TIGHT)
    assert_allclose(np.linalg.det(m), 1.0, atol=TIGHT)
    assert_allclose(rot.matrix_from_quat(rot.quat_mul(a, b)), m @ rot.matrix_from_quat(b), atol=TIGHT)


@given(seeds)
def test_a_vector_turns_alike_by_quaternion_and_matrix(seed: int) -> None:
    rng = np.random.default_rng(seed)
    q, v = random_quats(rng, 8), rng.standard_normal((8, 3))
    assert_allclose(rot.quat_apply(q, v), np.einsum("nij,nj->ni", rot.matrix_from_quat(q), v), atol=TIGHT)


@given(seeds)
def test_every_form_comes_back_from_a_matrix(seed: int) -> None:
    m = random_matrices(np.random.default_rng(seed), 8)
    q = rot.quat_from_matrix(m)
    assert (q[:, 0] >= 0).all()
    assert_allclose(rot.matrix_from_quat(q), m, atol=1e-10)
    assert_allclose(rot.matrix_from_6d(rot.matrix_to_6d(m)), m, atol=TIGHT)
    rotvec = rot.rotvec_from_matrix(m)
    assert (np.linalg.norm(rotvec, axis=-1) <= np.pi + 1e-9).all()
    assert_allclose(rot.matrix_from_rotvec(rotvec), m, atol=1e-10)


@given(seeds)
def test_half_turns_survive_every_form(seed: int) -> None:
    axis = rot.normalize(np.random.default_rng(seed).standard_normal((8, 3)))
    m = rot.matrix_from_axis_angle(axis, np.full(8, np.pi))
    assert_allclose(rot.matrix_from_quat(rot.quat_from_matrix(m)), m, atol=1e-9)
    assert_allclose(rot.matrix_from_rotvec(rot.rotvec_from_matrix(m)), m, atol=1e-9)


@given(seeds, st.floats(1e-9, 1e-3))
def test_small_rotation_vectors_keep_their_length(seed: int, angle: float) -> None:
    v = rot.normalize(np.random.default_rng(seed).standard_normal((8, 3))) * angle
    assert_allclose(rot.rotvec_from_matrix(rot.matrix_from_rotvec(v)), v, rtol=1e-6, atol=1e-15)


def test_no_rotation_is_zero_and_identity() -> None:
    assert_allclose(rot.rotvec_from_matrix(np.eye(3)), 0.0, atol=0)
    assert_allclose(rot.matrix_from_rotvec(np.zeros(3)), np.eye(3), atol=0)


def test_sixd_is_orthogonalised() -> None:
    """Columns (2,0,0) and (1,3,0): the first is scaled, the second loses its part along the first."""
    assert_allclose(rot.matrix_from_6d([2.0, 0.0, 0.0, 1.0, 3.0, 0.0]), np.eye(3), atol=TIGHT)


def test_a_quarter_turn_about_z_by_hand() -> None:
    quarter = rot.matrix_about_z(np.pi / 2)
    assert_allclose(quarter @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=TIGHT)
    assert_allclose(rot.quat_from_matrix(quarter), [np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)], atol=TIGHT)


@given(seeds)
def test_the_turn_between_directions_is_the_smallest(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = rot.normalize(rng.standard_normal((2, 8, 3)))
    m = rot.matrix_between(a, b)
    assert_allclose(np.einsum("nij,nj->ni", m, a), b, atol=1e-9)
    assert_allclose(angle_between(m, np.broadcast_to(np.eye(3), m.shape)), np.arccos(np.sum(a * b, -1)), atol=1e-6)


@given(seeds)
def test_the_turn_between_opposite_and_equal_directions(seed: int) -> None:
    a = rot.normalize(np.random.default_rng(seed).standard_normal((8, 3)))
    assert_allclose(np.einsum("nij,nj->ni", rot.matrix_between(a, -a), a), -a, atol=1e-9)
    assert_allclose(rot.matrix_between(a, a), np.broadcast_to(np.eye(3), (8, 3, 3)), atol=1e-7)


@given(seeds, st.floats(0.0, 1.0))
def test_slerp_goes_the_short_way_at_constant_speed(seed: int, t: float) -> None:
    a, b = random_quats(np.random.default_rng(seed), 2, 8)
    ma, mb = rot.matrix_from_quat(a), rot.matrix_from_quat(b)
    whole = angle_between(ma, mb)
    part = angle_between(ma, rot.matrix_from_quat(rot.quat_slerp(a, b, np.full(8, t))))
    assert_allclose(part, t * whole, atol=1e-6)
    assert_allclose(rot.quat_slerp(a, -b, np.full(8, t)), rot.quat_slerp(a, b, np.full(8, t)), atol=1e-12)


@given(st.floats(-100.0, 100.0))
def test_wrapped_angles_name_the_same_direction(angle: float) -> None:
    wrapped = float(rot.wrap_angle(angle))
    assert -np.pi - 1e-12 <= wrapped <= np.pi + 1e-12
    assert_allclose([np.cos(wrapped), np.sin(wrapped)], [np.cos(angle), np.sin(angle)], atol=1e-9)


def test_angles_wrap_at_two_pi_not_at_pi() -> None:
    """Facing backwards is not facing forwards: the difference of pi must not vanish (REFERENCE 4.2)."""
    assert abs(float(rot.wrap_angle(np.pi))) > 3.1
    assert_allclose(rot.wrap_angle(2 * np.pi), 0.0, atol=1e-12)
    assert_allclose(rot.wrap_angle(1.5 * np.pi), -0.5 * np.pi, atol=1e-12)
