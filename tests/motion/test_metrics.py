"""Motion metrics against cases worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from shared.motion import metrics
from shared.motion.ik import standing_clip
from shared.motion.skeleton import CANONICAL

FPS = 20.0


def _standing(frames: int = 10, lift_m: float = 0.0) -> np.ndarray:
    return standing_clip(frames, FPS).positions_w_m + [0.0, 0.0, lift_m]


def test_standing_is_without_fault() -> None:
    p = _standing()
    assert metrics.foot_contacts(p, FPS).all()
    assert metrics.penetration_mm(p) == 0.0
    assert metrics.floating_mm(p) == 0.0
    assert metrics.skating_mm_per_frame(p) == 0.0
    assert metrics.jerk_mps3(p, FPS) == pytest.approx(0.0, abs=1e-6)


def test_soles_are_under_the_feet() -> None:
    points = metrics.sole_points(_standing(1))
    assert points.shape == (1, 4, 3)
    assert_allclose(points[..., 2], 0.0, atol=1e-9)


def test_sinking_and_hovering_are_counted_beyond_the_tolerance() -> None:
    assert metrics.penetration_mm(_standing(lift_m=-0.02)) == pytest.approx(20.0)
    assert metrics.floating_mm(_standing(lift_m=-0.02)) == 0.0
    assert metrics.floating_mm(_standing(lift_m=0.03)) == pytest.approx(30.0)
    assert metrics.penetration_mm(_standing(lift_m=0.03)) == 0.0
    assert metrics.penetration_mm(_standing(lift_m=-0.004)) == 0.0
    assert metrics.floating_mm(_standing(lift_m=0.004)) == 0.0


def test_half_the_frames_count_half() -> None:
    p = _standing(10)
    p[:5, :, 2] -= 0.02
    assert metrics.penetration_mm(p) == pytest.approx(10.0)


def test_a_puppet_that_slides_skates_by_its_speed() -> None:
    p = _standing(10)
    p[..., 0] += 0.01 * np.arange(10)[:, None]
    assert metrics.skating_mm_per_frame(p) == pytest.approx(10.0)


def test_moving_feet_that_are_lifted_do_not_skate() -> None:
    p = _standing(10, lift_m=0.1)
    p[..., 0] += 0.01 * np.arange(10)[:, None]
    assert metrics.skating_mm_per_frame(p) == 0.0
    assert not metrics.foot_contacts(p, FPS).any()


def test_contact_ends_with_height_and_with_speed() -> None:
    assert not metrics.foot_contacts(_standing(lift_m=metrics.CONTACT_HEIGHT_M + 0.01), FPS).any()
    p = _standing(10)
    p[..., 1] += (metrics.CONTACT_SPEED_MPS + 0.1) / FPS * np.arange(10)[:, None]
    assert not metrics.foot_contacts(p, FPS).any()


def test_contacts_tell_the_feet_apart() -> None:
    p = _standing(4)
    p[:, CANONICAL.indices("left_ankle", "left_foot"), 2] += 0.2
    assert metrics.foot_contacts(p, FPS).tolist() == [[False, False, True, True]] * 4


def test_jerk_of_a_cubic() -> None:
    """x = t^3 has a third derivative of 6 m/s^3, at any rate."""
    for fps in (20.0, 30.0):
        p = _standing(12)
        p[..., 0] += (np.arange(12) / fps)[:, None] ** 3
        assert metrics.jerk_mps3(p, fps) == pytest.approx(6.0, rel=1e-6)


def test_limbs_are_slow_however_the_whole_body_goes() -> None:
    p = _standing(21)
    assert metrics.limb_speed_mps(p, FPS) == pytest.approx(0.0, abs=1e-9)
    angle = np.linspace(0.0, 2.0, len(p))[:, None]
    turned = p.copy()
    turned[..., 0], turned[..., 1] = (
        np.cos(angle) * p[..., 0] - np.sin(angle) * p[..., 1] + 3.0 * angle,
        np.sin(angle) * p[..., 0] + np.cos(angle) * p[..., 1],
    )
    assert metrics.limb_speed_mps(turned, FPS) == pytest.approx(0.0, abs=1e-9)
    waving = p.copy()
    waving[:, CANONICAL.index("left_wrist"), 1] += 0.05 * np.arange(len(p))
    assert metrics.limb_speed_mps(waving, FPS) == pytest.approx(1.0 / 22)
    assert metrics.limb_speed_mps(p + [0.0, 0.0, 0.02] * np.arange(len(p))[:, None, None], FPS) == pytest.approx(0.4)
