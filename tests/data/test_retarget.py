"""Retargeting and grounding on motion whose answer is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from shared.data.grounding import contacts, fix_heights, ground, measure
from shared.data.importer import import_path, load_clip
from shared.data.pieces import glitch_free
from shared.data.retarget import calibrate, retarget
from shared.errors import InvalidInputError
from shared.motion.body import J, heading_rad, mirror, origin_start, place, sole_height, sole_points
from shared.motion.ik import clip_from_positions
from shared.motion.io.bvh import read_bvh, write_bvh
from shared.motion.limbs import MIN_BEND_RAD, bends_rad, two_bone
from shared.motion.rotations import normalize
from shared.motion.skeleton import CANONICAL
from tests.data.samples import stand, stepping


def test_two_bones_reach_their_target_and_keep_their_lengths() -> None:
    rng = np.random.default_rng(0)
    target = normalize(rng.normal(size=(50, 3))) * rng.uniform(0.3, 0.7, (50, 1))
    mid, end = two_bone(np.zeros((50, 3)), target, 0.43, 0.42, rng.normal(size=(50, 3)))
    np.testing.assert_allclose(end, target, atol=1e-3)
    np.testing.assert_allclose(np.linalg.norm(mid, axis=-1), 0.43, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(end - mid, axis=-1), 0.42, atol=1e-9)


def test_a_limb_never_comes_closer_to_straight_than_the_least_bend() -> None:
    target = np.array([[0.0, 0.0, -2.0]])
    mid, end = two_bone(np.zeros((1, 3)), target, 0.43, 0.42, np.array([[1.0, 0.0, 0.0]]))
    u, v = normalize(mid), normalize(end - mid)
    assert np.arccos(np.sum(u * v)) >= MIN_BEND_RAD - 1e-6
    assert mid[0, 0] > 0  # on the pole's side


def test_a_clip_of_the_canonical_skeleton_comes_back_as_it_was(tmp_path: Path) -> None:
    p = stepping()
    write_bvh(tmp_path / "walk.bvh", clip_from_positions(p, 30.0, rebuild=True))
    raw = read_bvh(tmp_path / "walk.bvh")
    q = retarget(raw)
    np.testing.assert_allclose(q - q[:1, :1], p - p[:1, :1], atol=0.03)


@pytest.mark.parametrize("scale", [0.7, 1.3])
def test_a_person_of_another_size_walks_in_proportion(tmp_path: Path, scale: float) -> None:
    p = stepping()
    write_bvh(tmp_path / "walk.bvh", clip_from_positions(p, 30.0, rebuild=True), unit_m=0.01 / scale)
    raw = read_bvh(tmp_path / "walk.bvh", unit_m=0.01)
    q = retarget(raw)
    bones = np.linalg.norm(q - q[:, np.maximum(CANONICAL.parents, 0)], axis=-1)
    np.testing.assert_allclose(bones, np.broadcast_to(CANONICAL.bone_lengths_m, bones.shape), atol=1e-9)
    # Leg lengths are equalised, so the way walked is that of the canonical body.
    assert q[-1, 0, 0] - q[0, 0, 0] == pytest.approx(p[-1, 0, 0] - p[0, 0, 0], rel=0.01)


def test_grounding_puts_a_floating_stand_on_the_floor() -> None:
    for offset in (-0.3, 0.4):
        q, quality = ground(stand() + [0.0, 0.0, offset])
        assert np.abs(sole_height(q)).max() < 2e-3
        assert quality.skating_mm < 0.1
        assert quality.bone_error_mm < 1e-6


def test_grounding_stops_a_planted_foot_from_sliding() -> None:
    p = stepping()
    slid = p + np.stack([0.05 * np.arange(len(p)) / 30, np.zeros(len(p)), np.zeros(len(p))], axis=-1)[:, None]
    before, after = measure(slid, 30.0), ground(slid)[1]
    assert before.skating_mm > 1.0
    assert after.skating_mm < 0.5
    assert after.max_penetration_mm < 2.0


def test_a_jump_stays_a_jump() -> None:
    p = stand(60)
    t = np.clip((np.arange(60) - 20) / 30.0, 0.0, 0.5)
    p = p + np.stack([np.zeros(60), np.zeros(60), 9.81 * t * (0.5 - t) / 2], axis=-1)[:, None]
    q, _ = fix_heights(p, 30.0)
    assert sole_height(q).max() > 0.25
    assert np.abs(sole_height(q)[:15]).max() < 0.01
    assert np.abs(sole_height(q)[-15:]).max() < 0.01


def test_contacts_of_a_walk_alternate() -> None:
    planted = contacts(stepping(), 30.0).any(axis=-1)
    assert 0.4 < planted[:, 0].mean() < 0.75
    assert planted.any(axis=-1).mean() > 0.9


def test_knees_and_elbows_keep_their_least_bend_after_grounding() -> None:
    q, _ = ground(stepping())
    for bend in bends_rad(q).values():
        assert bend.min() > MIN_BEND_RAD - 1e-3


def test_a_broken_frame_is_cut_out() -> None:
    p = stepping(200)
    p[120, J["left_wrist"]] += 2.0
    pieces = glitch_free(p)
    assert [b - a > 50 for a, b in pieces] == [True, True]
    assert not any(a <= 120 < b for a, b in pieces)


def test_mirroring_twice_is_the_identity_and_swaps_the_feet() -> None:
    p = stepping()
    np.testing.assert_allclose(mirror(mirror(p)), p)
    np.testing.assert_allclose(mirror(p)[:, J["left_ankle"], 0], p[:, J["right_ankle"], 0])


def test_origin_start_and_place() -> None:
    p = place(stand(5), 1.1, np.array([3.0, -2.0]))
    assert heading_rad(p)[0] == pytest.approx(1.1)
    q = origin_start(p)
    assert heading_rad(q)[0] == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(q[0, 0, :2], 0.0, atol=1e-12)


def test_sole_of_the_rest_pose_is_on_the_floor() -> None:
    rest = CANONICAL.rest_positions_m[None]
    for side in ("left", "right"):
        np.testing.assert_allclose(sole_points(rest, side)[..., 2], 0.0, atol=1e-3)


def test_import_writes_clips_and_reports_what_fails(tmp_path: Path) -> None:
    source = tmp_path / "in"
    source.mkdir()
    write_bvh(source / "good.bvh", clip_from_positions(stepping(), 30.0, rebuild=True))
    (source / "bad.bvh").write_text("not motion")
    entries = import_path(source, tmp_path / "out")
    assert [("error" in e) for e in entries] == [True, False]
    assert (tmp_path / "out" / "good.npz").exists()
    clip, _ = load_clip(tmp_path / "out" / "good.bvh")
    assert len(clip) >= 115
    with pytest.raises(InvalidInputError, match="no motion files"):
        import_path(tmp_path / "nothing", tmp_path / "out")


def test_calibration_of_the_canonical_skeleton_is_nearly_the_identity(tmp_path: Path) -> None:
    write_bvh(tmp_path / "walk.bvh", clip_from_positions(stepping(), 30.0, rebuild=True))
    c = calibrate([read_bvh(tmp_path / "walk.bvh")])
    for name in ("pelvis", "chest", "head"):
        np.testing.assert_allclose(c.segments[name], np.eye(3), atol=1e-6)
