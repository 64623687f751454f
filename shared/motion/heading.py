"""Heading: the angle about the world's Z of the way something faces, 0 along +X, pi/2 along +Y.

A body's heading is the horizontal normal of the axes across it. Two are in use, both defined here and nowhere else:
the hips' is what states, tasks and their rules go by, as it does not swing with the arms; `body_heading`, of hips and
shoulders together, is HumanML3D's, on which planners are trained and by which they honour a heading that is asked for.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from shared.motion.skeleton import CANONICAL, Skeleton

Array = npt.NDArray[np.float64]


def heading_of(direction_w: npt.ArrayLike) -> Array:
    """Heading (...) in radians of directions (..., 2 or 3)."""
    d = np.asarray(direction_w, dtype=np.float64)
    return np.arctan2(d[..., 1], d[..., 0])


def faced_by(left_w: npt.ArrayLike) -> Array:
    """(..., 3) horizontal direction, not of unit length, that a body faces whose left side lies along (..., 3)."""
    left = np.asarray(left_w, dtype=np.float64)
    return np.stack([left[..., 1], -left[..., 0], np.zeros_like(left[..., 0])], axis=-1)


def hips_heading(positions_w_m: npt.ArrayLike, skeleton: Skeleton = CANONICAL) -> Array:
    """Heading (...) in radians of the hips of bodies (..., J, 3)."""
    return heading_of(faced_by(_across(positions_w_m, skeleton, "hip")))


def body_heading(positions_w_m: npt.ArrayLike, skeleton: Skeleton = CANONICAL) -> Array:
    """Heading (...) in radians of bodies (..., J, 3), by hips and shoulders."""
    across = _across(positions_w_m, skeleton, "hip") + _across(positions_w_m, skeleton, "shoulder")
    return heading_of(faced_by(across))


def _across(positions_w_m: npt.ArrayLike, skeleton: Skeleton, joint: str) -> Array:
    p = np.asarray(positions_w_m, dtype=np.float64)
    left, right = skeleton.indices(f"left_{joint}", f"right_{joint}")
    return p[..., left, :] - p[..., right, :]
