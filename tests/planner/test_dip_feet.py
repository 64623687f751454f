"""Planted feet: a creeping foot is held, a lifted one is let go and clears the floor, bones stay exact."""

from __future__ import annotations

import numpy as np

from planner_service.dip.feet import CLEAR_M, MOST_HELD_M, Array, held_offsets, walks, with_planted_feet
from planner_service.training.evaluate_quality import contact_slide_mm
from shared.motion.ik import standing_clip
from shared.motion.metrics import penetration_mm
from shared.motion.skeleton import CANONICAL

STANDING = standing_clip(41, 20.0).positions_w_m


def test_a_held_foot_stays_and_a_free_one_returns() -> None:
    path = np.stack([np.linspace(0.0, 0.04, 41), np.zeros(41)], axis=-1)
    contact = np.arange(41) < 20
    offset = held_offsets(path, contact)
    held = path + offset
    assert np.abs(np.diff(held[:20], axis=0)).max() < 0.001
    assert np.abs(offset[-1]).max() < 1e-4
    assert not offset[0].any()


def test_a_foot_is_never_held_far_from_its_path() -> None:
    path = np.stack([np.linspace(0.0, 2.0, 41), np.zeros(41)], axis=-1)
    assert np.linalg.norm(held_offsets(path, np.ones(41, np.bool_)), axis=-1).max() <= MOST_HELD_M + 1e-9


def test_planted_plan_slides_less_and_has_exact_bones() -> None:
    bent = STANDING.copy()
    bent[..., 2] -= 0.05
    feet = CANONICAL.indices("left_ankle", "right_ankle", "left_foot", "right_foot")
    bent[:, feet, 2] = STANDING[:, feet, 2]
    bent[..., 0] += np.linspace(0.0, 0.06, 41)[:, None]
    clip = with_planted_feet(bent, np.ones((41, 4)), 20.0)
    assert len(clip) == 40
    assert contact_slide_mm(clip.positions_w_m) < 0.4 * contact_slide_mm(bent[1:])
    parents = np.array(CANONICAL.parents[1:])
    bones = np.linalg.norm(clip.positions_w_m[:, 1:] - clip.positions_w_m[:, parents], axis=-1)
    np.testing.assert_allclose(bones, np.broadcast_to(CANONICAL.bone_lengths_m[1:], bones.shape), atol=1e-6)


def test_feet_are_lifted_out_of_the_floor() -> None:
    sunk = STANDING - [0.0, 0.0, 0.06]
    assert penetration_mm(sunk) > 50
    assert penetration_mm(with_planted_feet(sunk, np.zeros((41, 4)), 20.0).positions_w_m) < 5


def test_toes_are_put_where_they_are_wanted_and_the_other_foot_stays() -> None:
    toe, other = CANONICAL.indices("left_foot", "right_foot")
    wanted = STANDING.copy()
    wanted[..., 2] -= 0.05
    feet = CANONICAL.indices("left_ankle", "right_ankle", "left_foot", "right_foot")
    wanted[:, feet, 2] = STANDING[:, feet, 2]
    wanted[20:24, toe] += [0.1, 0.05, 0.15]
    plain, put = (with_planted_feet(wanted, np.zeros((41, 4)), 20.0, toes=toes) for toes in ({}, {"left": [21]}))
    assert np.linalg.norm(plain.positions_w_m[21, toe] - wanted[22, toe]) > 0.05
    assert np.linalg.norm(put.positions_w_m[21, toe] - wanted[22, toe]) < 0.02
    np.testing.assert_allclose(put.positions_w_m[:, other], plain.positions_w_m[:, other], atol=1e-6)
    np.testing.assert_allclose(put.positions_w_m[5, toe], plain.positions_w_m[5, toe], atol=1e-6)


def test_toes_stay_where_they_stand_while_the_heel_rises() -> None:
    hip_low = STANDING.copy()
    hip_low[..., 2] -= 0.08
    ankle, toe = CANONICAL.indices("left_ankle", "left_foot")
    feet = CANONICAL.indices("left_ankle", "right_ankle", "left_foot", "right_foot")
    hip_low[:, feet, 2] = STANDING[:, feet, 2]
    rise = np.linspace(0.0, 0.03, 41)[:, None]
    hip_low[:, ankle] += rise * [1.0, 0.0, 1.0]
    hip_low[:, toe] += rise * [1.0, 0.0, 0.0]  # creeps on
    contacts = np.zeros((41, 4))
    free = with_planted_feet(hip_low, contacts, 20.0, walking=True).positions_w_m
    contacts[:, 1] = 1.0  # the left toes
    kept = with_planted_feet(hip_low, contacts, 20.0, walking=True).positions_w_m
    assert np.ptp(free[:, toe, 0]) > 0.015
    assert np.ptp(kept[:, toe, 0]) < 0.005
    assert kept[-1, ankle, 2] > STANDING[0, ankle, 2] + 0.025  # the heel is up all the same


def test_who_stands_or_runs_does_not_walk() -> None:
    for mps, walking in ((0.0, False), (0.2, False), (0.6, True), (1.5, True), (2.5, False)):
        gone = STANDING + np.linspace(0.0, 2.0 * mps, 41)[:, None, None] * [1.0, 0.0, 0.0]
        assert walks(gone, 20.0) is walking, mps


def test_who_walks_swings_a_foot_clear_of_the_floor_while_the_other_stands() -> None:
    ankles, feet = CANONICAL.indices("left_ankle", "right_ankle"), CANONICAL.indices("left_foot", "right_foot")

    def least_m(way_m: float, stands: Array, walking: bool = True) -> list[float]:
        """Heights of both ankles and toes above where they rest, of who is dragged over the floor for two seconds."""
        wanted = STANDING.copy()
        wanted[..., 2] -= 0.05
        wanted[:, [*ankles, *feet], 2] = STANDING[:, [*ankles, *feet], 2]
        wanted[..., 0] += np.linspace(0.0, way_m, 41)[:, None]
        moved = with_planted_feet(wanted, stands, 20.0, walking=walking).positions_w_m
        return [float((moved[5:-5, j, 2] - STANDING[0, j, 2]).min()) for j in (*ankles, *feet)]

    right_stands = np.array([[0.0, 0.0, 1.0, 1.0]] * 41)
    left, right, left_toes, right_toes = least_m(2.4, right_stands)
    assert min(left, left_toes) > 0.8 * CLEAR_M
    assert max(right, right_toes) < 0.2 * CLEAR_M
    for way_m, stands, walking in (
        (0.6, right_stands, True),
        (2.4, np.zeros((41, 4)), True),
        (2.4, right_stands, False),
    ):
        assert max(least_m(way_m, stands, walking)) < 0.2 * CLEAR_M
