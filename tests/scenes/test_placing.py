"""What a seed draws, and where marks are while their objects move."""

from __future__ import annotations

import numpy as np
import pytest

from shared.motion.rotations import matrix_from_axis_angle, matrix_from_quat, quat_from_matrix, quat_mul
from shared.scenes.files import load_scene, parse_scene
from shared.scenes.placing import mark_place, pose_of, sampled
from shared.scenes.schema import Part

SEAT = parse_scene(
    """
    name: seat
    bodies:
      - name: before
        shape: sphere
        size_m: [0.1]
        position_w_m: [5, 5, 0.1]
      - name: seat
        position_w_m: [1, 2, 0]
        heading_deg: 90
        mass_kg: 10
        parts:
          - {shape: box, size_m: [0.2, 0.3, 0.2], position_b_m: [0, 0, 0.2]}
          - {shape: cylinder, size_m: [0.1, 0.3], position_b_m: [0.1, 0, 0.7]}
        random: {position_m: [[-1, 1], [0, 0]], size: [0.8, 1.2], height: [0.5, 1.5], mass: [2, 2]}
    marks:
      centre: {body: seat, position_b_m: [0.1, 0, 0.4], heading_deg: 30, half_size_m: [0.2, 0.3]}
      exit: {position_w_m: [0, 0, 0], heading_deg: -90}
    """
)


def test_a_seed_draws_the_same_everywhere_and_within_the_ranges() -> None:
    drawn = [sampled(SEAT, seed) for seed in range(200)]
    assert sampled(SEAT, 7) == drawn[7]
    assert sampled(drawn[7], 99) == drawn[7], "nothing is left to draw"
    for scene in drawn:
        box, tube = scene.bodies[1].parts
        size, height = box.size_m[0] / 0.2, box.size_m[2] / 0.2
        assert 0.8 <= size <= 1.2
        assert 0.5 <= height <= 1.5
        assert box.position_b_m == pytest.approx((0, 0, 0.2 * height))
        assert tube.size_m == pytest.approx((0.1 * size, 0.3 * height))
        assert scene.marks["centre"].position_b_m == pytest.approx((0.1 * size, 0, 0.4 * height))
        assert scene.marks["centre"].half_size_m == pytest.approx((0.2 * size, 0.3 * size))
        assert scene.bodies[1].mass_kg == 20
        assert scene.bodies[1].position_w_m[1] == 2
        assert scene.bodies[0] == SEAT.bodies[0]
        assert scene.marks["exit"] == SEAT.marks["exit"]
    xs = [scene.bodies[1].position_w_m[0] for scene in drawn]
    assert min(xs) < 0.2 and max(xs) > 1.8


def test_without_a_range_of_its_own_height_goes_with_size() -> None:
    text = (
        "name: b\nbodies: [{name: b, shape: box, size_m: [1, 1, 1], position_w_m: [0, 0, 1], random: {size: [0.5, 2]}}]"
    )
    for seed in range(5):
        drawn = sampled(parse_scene(text), seed).bodies[0]
        assert drawn.parts[0].size_m == pytest.approx((drawn.position_w_m[2],) * 3)


def test_a_mark_turns_and_moves_with_its_body() -> None:
    at_rest = mark_place(SEAT, "centre")
    np.testing.assert_allclose(at_rest.position_w_m, [1, 2.1, 0.4], atol=1e-12)
    assert at_rest.heading_rad == pytest.approx(np.deg2rad(120))
    turned = quat_from_matrix(matrix_from_axis_angle(np.array([0.0, 0.0, 1.0]), np.array(np.pi / 2)))
    moved = mark_place(SEAT, "centre", np.concatenate([[0, 0, 1], quat_mul(turned, pose_of(SEAT.bodies[1])[3:])]))
    np.testing.assert_allclose(moved.position_w_m, [-0.1, 0, 1.4], atol=1e-12)
    assert np.cos(moved.heading_rad - np.deg2rad(210)) == pytest.approx(1)
    assert mark_place(SEAT, "exit").heading_rad == pytest.approx(-np.pi / 2)


def test_a_part_is_turned_about_x_then_y_then_z() -> None:
    part = Part(shape="box", size_m=(1, 1, 1), rotation_deg=(20, -35, 70))
    x, y, z = (
        matrix_from_axis_angle(axis, np.deg2rad(np.array(angle)))
        for axis, angle in zip(np.eye(3), part.rotation_deg, strict=True)
    )
    np.testing.assert_allclose(matrix_from_quat(np.array(part.quat_b)), z @ y @ x, atol=1e-12)


def test_the_sofa_has_the_measures_of_the_reference() -> None:
    """Seat 0.344 m, back 0.736, arms 0.56, 2.7 m wide (REFERENCE 3)."""
    scene = load_scene("sofa")
    tops = [part.position_b_m[2] + part.size_m[2] for part in scene.bodies[0].parts]
    assert tops == pytest.approx([0.344, 0.736, 0.56, 0.56])
    assert 2 * scene.bodies[0].parts[0].size_m[1] == pytest.approx(2.7)
    assert mark_place(scene, "seat_centre").position_w_m[2] == pytest.approx(0.344)
