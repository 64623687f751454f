"""Made motion does what its label says, and stands on the floor."""

from __future__ import annotations

import numpy as np
import pytest

from shared.data.grounding import ground
from shared.data.label import Label, locomotion_label, rotation_steps_rad, segment_locomotion, turned_rad
from shared.data.make_jump import jump_on_spot
from shared.data.make_paths import bend_path, find_starts, find_stops, yaw_pulse
from shared.data.make_stand import idle, turn_on_spot, wave
from shared.data.splice import crossfade, extend_cycle, local_rotations, rebuild, settle, settle_before
from shared.motion.body import J, heading_rad, sole_height
from shared.motion.skeleton import CANONICAL
from tests.data.samples import stand, stepping


def test_a_bent_walk_turns_by_the_integral_of_its_rate_and_keeps_its_length() -> None:
    p = stepping(121)
    q = bend_path(p, 0.5)
    assert heading_rad(q)[-1] - heading_rad(p)[-1] == pytest.approx(0.5 * 4.0, rel=0.03)
    way = [np.linalg.norm(np.diff(x[:, 0, :2], axis=0), axis=-1).sum() for x in (p, q)]
    assert way[1] == pytest.approx(way[0], rel=1e-3)
    assert locomotion_label(q).side == "left"
    assert locomotion_label(bend_path(p, -0.5)).side == "right"


def test_a_pulse_turns_by_its_angle() -> None:
    p = stepping(180)
    q = bend_path(p, yaw_pulse(180, np.radians(120), 1.5, 60))
    assert np.degrees(heading_rad(q)[-1]) == pytest.approx(120, abs=6)


@pytest.mark.parametrize("degrees", [-170, -70, 60, 180])
def test_turning_on_the_spot_reaches_its_angle_without_sliding(degrees: float) -> None:
    p = turn_on_spot(stand(1)[0], float(np.radians(degrees)), np.random.default_rng(1))
    q, quality = ground(p)
    assert np.degrees(turned_rad(q)) == pytest.approx(degrees, abs=8)
    assert np.linalg.norm(q[-1, 0, :2] - q[0, 0, :2]) < 0.15
    assert quality.skating_mm < 1.0
    assert quality.bone_error_mm < 1e-6
    assert sole_height(q).min(axis=1).max() < 0.01  # one foot is always down


def test_idling_stays_in_place() -> None:
    q, quality = ground(idle(stand(1)[0], 200, np.random.default_rng(2)))
    assert np.linalg.norm(q[:, 0, :2] - q[0, 0, :2], axis=-1).max() < 0.08
    assert np.ptp(q[:, 0, 1]) > 0.002  # but it lives
    assert quality.skating_mm < 0.1
    assert locomotion_label(q) == Label("stand", "stand")


@pytest.mark.parametrize("seed", range(4))
def test_a_made_jump_leaves_the_floor_and_lands_where_it_began(seed: int) -> None:
    q, quality = ground(jump_on_spot(stand(1)[0], np.random.default_rng(seed)))
    height = sole_height(q).min(axis=1)
    assert height.max() > 0.06
    assert np.abs(height[:10]).max() < 0.01
    assert np.abs(height[-10:]).max() < 0.01
    assert np.linalg.norm(q[-1, 0, :2] - q[0, 0, :2]) < 0.05
    assert quality.bone_error_mm < 1e-6
    # In flight the pelvis falls freely.
    air = np.flatnonzero(height > 0.04)
    fall = np.diff(q[air, 0, 2], 2) * 900
    assert fall.mean() == pytest.approx(-9.81, abs=2.5)


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("seed", range(5))
def test_a_wave_has_the_wrist_above_the_shoulder_and_two_reversals(side: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    p = wave(idle(stand(1)[0], 150, rng), side, rng, 0.3, 4.0)
    held = slice(45, 115)
    wrist, shoulder = p[held, J[f"{side}_wrist"]], p[held, J[f"{side}_shoulder"]]
    assert (wrist[:, 2] > shoulder[:, 2]).mean() > 0.95
    sideways = np.diff(wrist[:, 1])
    assert np.sum(np.diff(np.sign(sideways[np.abs(sideways) > 1e-4])) != 0) >= 2
    assert rotation_steps_rad(local_rotations(p)).max() < 0.6
    bones = np.linalg.norm(p - p[:, np.maximum(CANONICAL.parents, 0)], axis=-1)
    np.testing.assert_allclose(bones, np.broadcast_to(CANONICAL.bone_lengths_m, bones.shape), atol=1e-9)


def test_settling_ends_in_a_stand_without_a_jump() -> None:
    p = settle(stepping(70), 60)
    step = np.linalg.norm(np.diff(p, axis=0), axis=-1)
    assert step[69:72].max() < 1.3 * step[60:69].max() + 0.01
    assert step[-5:].max() < 2e-3
    assert len(settle_before(p, 30)) == len(p) + 30


def test_crossfading_meets_half_way() -> None:
    a, b = stepping(60), stepping(60) + [5.0, 5.0, 0.0]
    out = crossfade(a, b, 8)
    assert len(out) == 112
    assert np.linalg.norm(np.diff(out[:, 0], axis=0), axis=-1).max() < 0.08


def test_a_cycle_is_extended_as_walking() -> None:
    longer = extend_cycle(rebuild(stepping(80)), 200)
    assert longer is not None
    assert len(longer) >= 200
    speed = np.diff(longer[:, 0, 0]) * 30
    assert speed.min() > 0.7
    assert speed.max() < 1.3
    assert extend_cycle(stand(80), 200) is None  # a stand is no cycle that gets somewhere


def test_starts_and_stops_are_found() -> None:
    p = np.concatenate([np.repeat(stepping(1), 40, axis=0), stepping(90)])
    (a, b), *rest = find_starts(p)
    assert not rest
    assert a <= 40 <= b < 70
    (c, d), *rest = find_stops(p[::-1])
    assert not rest
    assert (len(p) - 1 - d, len(p) - 1 - c) == (a, b)


def test_segments_cover_a_take_and_are_long_enough() -> None:
    p = np.concatenate([np.repeat(stepping(1), 100, axis=0), stepping(200)])
    pieces = segment_locomotion(p)
    assert (pieces[0][0], pieces[-1][1]) == (0, len(p))
    assert all(b == c for (_, b), (c, _) in zip(pieces, pieces[1:], strict=False))
    assert all(b - a >= 60 for a, b in pieces)
    assert locomotion_label(p[slice(*pieces[0])]).behaviour == "stand"
    assert locomotion_label(p[slice(*pieces[-1])]).behaviour == "walk"
