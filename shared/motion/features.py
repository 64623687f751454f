"""G2R and R2G: world motion <-> HumanML3D's 263 features a frame (Guo et al., 2022), in our axes.

A frame's root frame has its origin below the pelvis on the floor and its X axis along the heading of the body. Rates
and velocities look back: those of frame i say what happened between frame i - 1 and frame i, so frames can be
appended one after another. The first frame of a window has no predecessor and repeats the rates of the second.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.errors import InvalidInputError
from shared.motion.heading import body_heading
from shared.motion.ik import rotations_from_positions
from shared.motion.metrics import foot_contacts
from shared.motion.resampling import finite_velocity
from shared.motion.rotations import matrix_to_6d, wrap_angle
from shared.motion.skeleton import CANONICAL, Skeleton

Array = npt.NDArray[np.float64]

JOINTS = 22
FEATURES = 263
YAW_RATE = slice(0, 1)
"""rad/s about Z."""
ROOT_VELOCITY = slice(1, 3)
"""m/s, horizontal, in the root frame of the frame before."""
ROOT_HEIGHT = slice(3, 4)
"""m."""
JOINT_POSITIONS = slice(4, 67)
"""21 x 3, joints 1..21 in the root frame, z above the floor, m."""
JOINT_ROTATIONS = slice(67, 193)
"""21 x 6, rotations relative to the parent."""
JOINT_VELOCITIES = slice(193, 259)
"""22 x 3, world velocities in the root frame, m/s."""
CONTACTS = slice(259, 263)
"""Left ankle, left toe base, right ankle, right toe base: 1 in contact."""


@dataclass(frozen=True)
class RootState:
    """Where a root frame is: xy (..., 2) on the floor in metres and heading (...) in radians."""

    xy_w_m: Array
    heading_rad: Array


def root_state(positions_w_m: npt.ArrayLike, skeleton: Skeleton = CANONICAL) -> RootState:
    """Root frame of each body (..., 22, 3)."""
    p = np.asarray(positions_w_m, dtype=np.float64)
    return RootState(p[..., 0, :2].copy(), body_heading(p, skeleton))


def rotate_z(vectors: Array, angle: Array) -> Array:
    """Vectors (..., 2 or 3) turned by `angle` (...) about Z."""
    c, s = np.cos(angle), np.sin(angle)
    out = vectors.copy()
    out[..., 0] = c * vectors[..., 0] - s * vectors[..., 1]
    out[..., 1] = s * vectors[..., 0] + c * vectors[..., 1]
    return out


def to_root_frame(points_w_m: npt.ArrayLike, state: RootState) -> Array:
    """World points (N, 3) seen from one root frame; z stays the height above the floor."""
    points = np.asarray(points_w_m, dtype=np.float64).copy()
    points[..., :2] -= state.xy_w_m
    return rotate_z(points, -np.asarray(state.heading_rad))


def from_root_frame(points_m: npt.ArrayLike, state: RootState) -> Array:
    """Inverse of `to_root_frame`."""
    points = rotate_z(np.asarray(points_m, dtype=np.float64), np.asarray(state.heading_rad))
    points[..., :2] += state.xy_w_m
    return points


def global_to_features(
    positions_w_m: npt.ArrayLike, fps: float, skeleton: Skeleton = CANONICAL, rotations_6d: npt.ArrayLike | None = None
) -> Array:
    """G2R: world positions (T, 22, 3) -> features (T, 263).

    Rotations come from the positions (IK) unless `rotations_6d` (T, 22, 6) gives the result of that same IK.
    Raises InvalidInputError for fewer than two frames.
    """
    p = np.asarray(positions_w_m, dtype=np.float64)
    if p.ndim != 3 or p.shape[0] < 2 or p.shape[1:] != (JOINTS, 3):
        raise InvalidInputError(f"positions of shape {p.shape}", field="positions_w_m", allowed="(T >= 2, 22, 3)")
    state = root_state(p, skeleton)
    heading = state.heading_rad
    rate = np.zeros(len(p))
    rate[1:] = wrap_angle(np.diff(heading)) * fps
    root_velocity = np.zeros((len(p), 2))
    root_velocity[1:] = rotate_z(np.diff(state.xy_w_m, axis=0) * fps, -heading[:-1])
    rate[0], root_velocity[0] = rate[1], root_velocity[1]

    local = p.copy()
    local[..., :2] -= state.xy_w_m[:, None]
    local = rotate_z(local, -heading[:, None])
    velocity = rotate_z(finite_velocity(p, fps), -heading[:, None])
    r6 = matrix_to_6d(rotations_from_positions(p, skeleton)) if rotations_6d is None else np.asarray(rotations_6d)
    return np.concatenate(
        [
            rate[:, None],
            root_velocity,
            p[:, 0, 2:],
            local[:, 1:].reshape(len(p), -1),
            r6[:, 1:].reshape(len(p), -1),
            velocity.reshape(len(p), -1),
            foot_contacts(p, fps, skeleton).astype(np.float64),
        ],
        axis=-1,
    )


def features_to_global(features: npt.ArrayLike, fps: float, first: RootState | None = None) -> Array:
    """R2G: features (T, 263) -> world positions (T, 22, 3).

    `first` is the root frame of frame 0; None stands for the origin and a heading of zero.
    """
    f = np.asarray(features, dtype=np.float64)
    xy0 = np.zeros(2) if first is None else np.asarray(first.xy_w_m)
    heading0 = 0.0 if first is None else float(first.heading_rad)
    heading = heading0 + np.concatenate([[0.0], np.cumsum(f[1:, 0] / fps)])
    steps = rotate_z(f[1:, ROOT_VELOCITY] / fps, heading[:-1])
    xy = xy0 + np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    out = np.zeros((len(f), JOINTS, 3))
    out[:, 0, 2] = f[:, 3]
    out[:, 1:] = f[:, JOINT_POSITIONS].reshape(len(f), JOINTS - 1, 3)
    out = rotate_z(out, heading[:, None])
    out[..., :2] += xy[:, None]
    return out
