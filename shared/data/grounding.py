"""Floor contact of retargeted motion: heights, planted feet, and how well it went.

The floor is z = 0. Flight keeps its height; whoever is supported stands on the floor; planted feet do not slide.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d, maximum_filter1d, median_filter

from shared.motion.body import (
    SIDES,
    Array,
    Bools,
    J,
    flesh_height,
    runs,
    sole_height,
    sole_points,
    velocity,
)
from shared.motion.limbs import reach, solve_leg, unlock_arms
from shared.motion.skeleton import CANONICAL
from shared.protocol.rates import CORPUS_FPS

_CONTACT_HEIGHT_M = 0.035
_CONTACT_SPEED_MPS = 0.55
_SUPPORT_HEIGHT_M = 0.05
_MAX_LOCK_M = 0.12
_MAX_DROP_M = 0.03
_REACH_MARGIN_M = 0.006


@dataclass(frozen=True)
class Quality:
    """How well a clip stands on the floor.

    Attributes:
        skating_mm: mean horizontal shift of the planted sole point per frame.
        penetration_mm: mean depth of the lowest point where below the floor, over all frames.
        max_penetration_mm: deepest point.
        floating_mm: mean height of the lowest point over frames that are supported.
        height_spread_m: range of the correction of height that was needed.
        bone_error_mm: largest error of a bone's length.
        max_joint_speed_mps: fastest joint.
    """

    skating_mm: float
    penetration_mm: float
    max_penetration_mm: float
    floating_mm: float
    height_spread_m: float
    bone_error_mm: float
    max_joint_speed_mps: float

    def as_dict(self) -> dict[str, float]:
        return {k: round(v, 4) for k, v in asdict(self).items()}


def _lowest(p: Array) -> Array:
    return np.asarray(np.minimum(sole_height(p).min(axis=-1), flesh_height(p)))


def _supported(p: Array, low: Array, fps: float) -> Bools:
    """Frames whose lowest point bears the body: near the floor and not falling freely."""
    acceleration = velocity(velocity(gaussian_filter1d(p[:, 0, 2], 1.0, mode="nearest"), fps), fps)
    flying = (low > 0.012) & (acceleration < -5.0)
    return np.asarray((low < _SUPPORT_HEIGHT_M) & ~flying)


def fix_heights(p: Array, fps: float) -> tuple[Array, float]:
    """Poses with the supporting points on the floor, and the spread of the slow correction (metres)."""
    low = _lowest(p)
    p = p - np.array([0.0, 0.0, np.percentile(low, 25)])
    low = low - np.percentile(low, 25)
    supported = _supported(p, low, fps)
    if not supported.any():
        return p, 0.0
    t = np.arange(len(p))
    lift = np.interp(t, t[supported], -low[supported])
    lift = gaussian_filter1d(lift, 2.0, mode="nearest")
    p = p + np.stack([np.zeros_like(lift), np.zeros_like(lift), lift], axis=-1)[:, None]
    # Trunk, arms and head have no IK to take them out of the floor: the whole body is lifted, smoothly.
    sunk = np.clip(-flesh_height(p), 0.0, None)
    if sunk.max() > 1e-3:
        push = gaussian_filter1d(maximum_filter1d(sunk, 9), 2.0, mode="nearest")
        p = p + np.stack([np.zeros_like(push), np.zeros_like(push), push], axis=-1)[:, None]
    return p, float(np.ptp(lift))


def contacts(p: Array, fps: float) -> Bools:
    """(T, 2 feet, 2 points) whether heel and ball of each foot are planted: low and slow for three frames or more."""
    out = np.zeros((len(p), 2, 2), dtype=bool)
    for i, side in enumerate(SIDES):
        points = sole_points(p, side)
        speed = np.linalg.norm(velocity(points, fps)[..., :2], axis=-1)
        raw = (points[..., 2] < _CONTACT_HEIGHT_M) & (speed < _CONTACT_SPEED_MPS)
        out[:, i] = median_filter(raw.astype(np.uint8), size=(3, 1), mode="nearest").astype(bool)
    return out


def _smoothstep(n: int) -> Array:
    x = (np.arange(n) + 1) / (n + 1)
    return np.asarray(x * x * (3 - 2 * x))


def _foot_shift(p: Array, side: str, planted: Bools) -> Array:
    """(T, 3) correction of one foot: planted points stand still on the floor, swings pass smoothly between."""
    points = sole_points(p, side)
    step = np.diff(points[..., :2], axis=0, prepend=points[:1, :, :2])
    # The ball leads where both are planted, so that a heel that lifts off does not drag the foot.
    moving = np.where(planted[:, 1:2], step[:, 1], step[:, 0])
    down: Bools = np.asarray(planted.any(axis=-1))
    shift = np.full((len(p), 3), np.nan)
    for a, b in runs(down):
        e = np.zeros((b - a, 2))
        e[1:] = -np.cumsum(moving[a + 1 : b], axis=0)
        span = float(np.max(np.ptp(e, axis=0)))
        e *= min(1.0, _MAX_LOCK_M / max(span, 1e-9))
        shift[a:b, :2] = e - e.mean(axis=0)
        shift[a:b, 2] = -points[a:b, :, 2].min(axis=-1)
    known = runs(down)
    if not known:
        shift[:] = 0.0
    else:
        shift[: known[0][0]] = shift[known[0][0]]
        shift[known[-1][1] :] = shift[known[-1][1] - 1]
        for (_, b), (a, _) in zip(known, known[1:], strict=False):
            w = _smoothstep(a - b)[:, None]
            shift[b:a] = (1 - w) * shift[b - 1] + w * shift[a]
    # Planted to swinging and back without a corner in the path; stance keeps still but for its first and last frame.
    shift = gaussian_filter1d(shift, 1.0, axis=0, mode="nearest")
    shift[:, 2] = np.maximum(shift[:, 2], -points[..., 2].min(axis=-1))
    return np.asarray(shift)


def lock_feet(p: Array, fps: float) -> Array:
    """Poses whose planted feet stand still on the floor, by moving ankles and, where needed, lowering the body."""
    planted = contacts(p, fps)
    targets = {}
    need = np.zeros(len(p))
    lengths = CANONICAL.bone_lengths_m
    longest = reach(float(lengths[J["left_knee"]]), float(lengths[J["left_ankle"]])) - _REACH_MARGIN_M
    for i, side in enumerate(SIDES):
        target = p[:, J[f"{side}_ankle"]] + _foot_shift(p, side, planted[:, i])
        gap = p[:, J[f"{side}_hip"]] - target
        flat = np.linalg.norm(gap[:, :2], axis=-1)
        drop = gap[:, 2] - np.sqrt(np.clip(longest**2 - flat**2, 0.0, None))
        need = np.maximum(need, np.where(planted[:, i].any(axis=-1), drop, 0.0))
        targets[side] = target
    need = gaussian_filter1d(maximum_filter1d(np.clip(need, 0.0, _MAX_DROP_M), 5), 2.0, mode="nearest")
    out = p - np.stack([np.zeros_like(need), np.zeros_like(need), need], axis=-1)[:, None]
    for side in SIDES:
        foot, ankle = J[f"{side}_foot"], J[f"{side}_ankle"]
        out[:, ankle], out[:, foot] = p[:, ankle], p[:, foot]
        out = solve_leg(out, side, targets[side])
    return np.asarray(out)


def ground(p: Array, fps: float = CORPUS_FPS) -> tuple[Array, Quality]:
    """Heights fixed, planted feet locked, elbows and knees off their straight position. p: (T, 22, 3)."""
    p, spread = fix_heights(p, fps)
    p = unlock_arms(p)
    for _ in range(2):
        p = lock_feet(p, fps)
    # What is still below the floor (knees and hands of someone lying) is lifted with the whole body.
    sunk = np.clip(-_lowest(p), 0.0, None)
    if sunk.max() > 2e-3:
        push = np.maximum(gaussian_filter1d(maximum_filter1d(sunk, 9), 2.0, mode="nearest"), sunk)
        p = p + np.stack([np.zeros_like(push), np.zeros_like(push), push], axis=-1)[:, None]
    return p, measure(p, fps, spread)


def measure(p: Array, fps: float, spread: float = 0.0) -> Quality:
    """Quality figures of a clip."""
    planted = contacts(p, fps)
    slid, count = 0.0, 0
    for i, side in enumerate(SIDES):
        points = sole_points(p, side)
        step = np.linalg.norm(np.diff(points[..., :2], axis=0), axis=-1)
        both = planted[1:, i] & planted[:-1, i]
        lead = np.where(both[:, 1], step[:, 1], step[:, 0])
        slid += float(lead[both.any(axis=-1)].sum())
        count += int(both.any(axis=-1).sum())
    low = _lowest(p)
    supported = _supported(p, low, fps)
    bones = np.linalg.norm(p - p[:, np.maximum(CANONICAL.parents, 0)], axis=-1)
    speed = np.linalg.norm(velocity(p, fps), axis=-1)
    return Quality(
        skating_mm=1000 * slid / max(count, 1),
        penetration_mm=float(1000 * np.clip(-low, 0.0, None).mean()),
        max_penetration_mm=float(1000 * np.clip(-low, 0.0, None).max()),
        floating_mm=float(1000 * np.clip(low[supported], 0.0, None).mean()) if supported.any() else 0.0,
        height_spread_m=spread,
        bone_error_mm=float(1000 * np.abs(bones - CANONICAL.bone_lengths_m).max()),
        max_joint_speed_mps=float(speed.max()),
    )
