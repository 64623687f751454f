"""Small numpy helpers over poses of the canonical skeleton, given as joint positions (T, 22, 3)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from shared.motion.heading import faced_by, hips_heading
from shared.motion.rotations import normalize
from shared.motion.skeleton import CANONICAL

Array = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]
SIDES = ("left", "right")

SOLE_UNDER_ANKLE_M = 0.0683
SOLE_UNDER_BALL_M = 0.0183
HEEL_BEHIND_ANKLE_M = 0.05

J = {name: i for i, name in enumerate(CANONICAL.names)}
"""Index of each canonical joint by name."""

_FOOT = CANONICAL.offsets_m[J["left_foot"]]
_FOOT_PITCH = float(np.arctan2(-_FOOT[2], _FOOT[0]))
_FLESH_M = {
    "pelvis": 0.09, "left_hip": 0.08, "right_hip": 0.08, "left_knee": 0.05, "right_knee": 0.05, "spine1": 0.09,
    "spine2": 0.09, "spine3": 0.09, "neck": 0.05, "head": 0.08, "left_shoulder": 0.05, "right_shoulder": 0.05,
    "left_elbow": 0.035, "right_elbow": 0.035, "left_wrist": 0.025, "right_wrist": 0.025,
}  # fmt: skip


def left_axis(p: Array) -> Array:
    """(T, 3) unit vector from the right hip to the left one."""
    return normalize(p[..., J["left_hip"], :] - p[..., J["right_hip"], :])


def forward_of(p: Array) -> Array:
    """(T, 3) horizontal unit vector the pelvis faces."""
    return normalize(faced_by(left_axis(p)))


def heading_rad(p: Array) -> Array:
    """(T,) unwrapped heading of the hips."""
    return np.unwrap(hips_heading(p))


def foot_axes(p: Array, side: str) -> tuple[Array, Array]:
    """Forward and up unit vectors (T, 3) of a foot's sole, from the ankle and the ball of the foot."""
    d = normalize(p[..., J[f"{side}_foot"], :] - p[..., J[f"{side}_ankle"], :])
    across = np.cross([0.0, 0.0, 1.0], d)
    flat = np.linalg.norm(across, axis=-1, keepdims=True)
    # A foot that points straight down has no heading of its own: the hips give the lateral axis.
    y = normalize(across + np.clip(0.3 - flat, 0.0, None) * left_axis(p))
    y = normalize(y - np.sum(y * d, axis=-1, keepdims=True) * d)
    n = np.cross(d, y)
    return d * np.cos(_FOOT_PITCH) + n * np.sin(_FOOT_PITCH), n * np.cos(_FOOT_PITCH) - d * np.sin(_FOOT_PITCH)


def sole_points(p: Array, side: str) -> Array:
    """(T, 2, 3) heel and ball of the sole."""
    x, up = foot_axes(p, side)
    heel = p[..., J[f"{side}_ankle"], :] - HEEL_BEHIND_ANKLE_M * x - SOLE_UNDER_ANKLE_M * up
    # The toes stay level while the heel is up, so the ball's sole is straight below its joint.
    ball = p[..., J[f"{side}_foot"], :] - np.array([0.0, 0.0, SOLE_UNDER_BALL_M])
    return np.stack([heel, ball], axis=-2)


def sole_height(p: Array) -> Array:
    """(T, 2) height of the lowest sole point of the left and right foot."""
    return np.stack([sole_points(p, side)[..., 2].min(axis=-1) for side in SIDES], axis=-1)


def flesh_height(p: Array) -> Array:
    """(T,) height of the lowest point of the rest of the body, joints taken as balls."""
    joints = np.array([J[name] for name in _FLESH_M])
    return np.asarray((p[..., joints, 2] - np.array(list(_FLESH_M.values()))).min(axis=-1))


def velocity(x: Array, fps: float) -> Array:
    """Central differences along the first axis, one-sided at the ends."""
    return np.asarray(np.gradient(x, axis=0) * fps) if len(x) > 1 else np.zeros_like(x)


def runs(mask: Bools) -> list[tuple[int, int]]:
    """Half-open intervals [start, stop) where a boolean (T,) is true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def mirror(p: Array) -> Array:
    """The pose seen in a mirror at y = 0."""
    return np.asarray(p[..., CANONICAL.mirror_map, :] * np.array([1.0, -1.0, 1.0]))


def place(p: Array, yaw_rad: float | Array, shift: Array | None = None, pivot: Array | None = None) -> Array:
    """Poses (T, J, 3) turned about the vertical through `pivot`, then shifted.

    yaw_rad: scalar or (T,); shift and pivot: (2,) or (T, 2) metres, by default none and the origin.
    """
    yaw = np.broadcast_to(np.asarray(yaw_rad, dtype=np.float64), (len(p),))[:, None]
    centre = np.broadcast_to(np.zeros(2) if pivot is None else pivot, (len(p), 2))[:, None]
    move = np.broadcast_to(np.zeros(2) if shift is None else shift, (len(p), 2))[:, None]
    x, y = p[..., 0] - centre[..., 0], p[..., 1] - centre[..., 1]
    c, s = np.cos(yaw), np.sin(yaw)
    out = p.copy()
    out[..., 0] = c * x - s * y + centre[..., 0] + move[..., 0]
    out[..., 1] = s * x + c * y + centre[..., 1] + move[..., 1]
    return out


def origin_start(p: Array) -> Array:
    """The motion turned and shifted so that its first frame stands over the origin facing +X."""
    out = place(p, -float(heading_rad(p[:1])[0]))
    return np.asarray(out - np.array([out[0, 0, 0], out[0, 0, 1], 0.0]))
