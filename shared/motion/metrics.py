"""Physical plausibility of motion: contacts, penetration, floating, skating (after PhysDiff), jerk; and its vigour.

The sole is taken as two points below each foot: under the ankle and under the toe base, as deep as those joints stand
above the floor in the rest pose.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from shared.motion.heading import hips_heading
from shared.motion.resampling import finite_velocity
from shared.motion.skeleton import CANONICAL, Skeleton

Array = npt.NDArray[np.float64]

FOOT_JOINTS = ("left_ankle", "left_foot", "right_ankle", "right_foot")
CONTACT_HEIGHT_M = 0.05
"""A sole point lower than this above the floor ..."""
CONTACT_SPEED_MPS = 0.4
"""... and slower than this is in contact."""
TOLERANCE_M = 0.005
"""Penetration and floating up to this are not counted (PhysDiff)."""


def sole_points(positions_w_m: npt.ArrayLike, skeleton: Skeleton = CANONICAL) -> Array:
    """Points (T, 4, 3) under left ankle, left toe base, right ankle, right toe base."""
    index = skeleton.indices(*FOOT_JOINTS)
    points = np.asarray(positions_w_m, dtype=np.float64)[:, index].copy()
    points[..., 2] -= skeleton.rest_positions_m[index, 2]
    return points


def foot_contacts(positions_w_m: npt.ArrayLike, fps: float, skeleton: Skeleton = CANONICAL) -> npt.NDArray[np.bool_]:
    """(T, 4) whether each sole point is low and slow; order as `sole_points`."""
    points = sole_points(positions_w_m, skeleton)
    speed = np.linalg.norm(finite_velocity(points, fps), axis=-1)
    return (points[..., 2] < CONTACT_HEIGHT_M) & (speed < CONTACT_SPEED_MPS)


def penetration_mm(positions_w_m: npt.ArrayLike, skeleton: Skeleton = CANONICAL) -> float:
    """Mean depth below the floor of the lowest sole point, beyond the tolerance."""
    lowest = sole_points(positions_w_m, skeleton)[..., 2].min(axis=-1)
    return float(np.where(lowest < -TOLERANCE_M, -lowest, 0.0).mean() * 1e3)


def floating_mm(positions_w_m: npt.ArrayLike, skeleton: Skeleton = CANONICAL) -> float:
    """Mean height above the floor of the lowest sole point, beyond the tolerance."""
    lowest = sole_points(positions_w_m, skeleton)[..., 2].min(axis=-1)
    return float(np.where(lowest > TOLERANCE_M, lowest, 0.0).mean() * 1e3)


def skating_mm_per_frame(positions_w_m: npt.ArrayLike, skeleton: Skeleton = CANONICAL) -> float:
    """Mean horizontal way of the sole points between consecutive frames in both of which they are on the floor.

    "On the floor" is by height alone, so that a sliding foot counts; 0.0 if no point ever is.
    """
    points = sole_points(positions_w_m, skeleton)
    low = points[..., 2] < 0.02
    both = low[1:] & low[:-1]
    way = np.linalg.norm(np.diff(points[..., :2], axis=0), axis=-1)
    return float(way[both].mean() * 1e3) if both.any() else 0.0


def jerk_mps3(positions_w_m: npt.ArrayLike, fps: float) -> float:
    """Mean size of the third derivative of joint positions, by third differences; needs four frames."""
    p = np.asarray(positions_w_m, dtype=np.float64)
    third = np.diff(p, n=3, axis=0) * fps**3
    return float(np.linalg.norm(third, axis=-1).mean())


def limb_speed_mps(positions_w_m: npt.ArrayLike, fps: float) -> float:
    """Mean speed of the joints of a motion (T, 22, 3) as the body sees them: its way and turns do not count."""
    p = np.asarray(positions_w_m, dtype=np.float64)
    heading = hips_heading(p)[:, None]
    c, s = np.cos(heading), np.sin(heading)
    x, y = p[..., 0] - p[:, :1, 0], p[..., 1] - p[:, :1, 1]
    seen = np.stack([c * x + s * y, c * y - s * x, p[..., 2]], axis=-1)
    return float(np.linalg.norm(np.diff(seen, axis=0), axis=-1).mean()) * fps
