"""Paths bent in feature space: a yaw rate added to the root, about the foot that stands (DESIGN 9, REFERENCE 6).

Turning about the standing foot instead of the root bends the path as much, but the foot stays where it is: turning
about the root would drag it 9 mm a frame at 0.6 rad/s.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from planner_service.training.windows import Features
from shared.motion.features import CONTACTS, JOINT_POSITIONS, JOINT_VELOCITIES, ROOT_VELOCITY
from shared.motion.metrics import FOOT_JOINTS
from shared.motion.skeleton import CANONICAL
from shared.protocol.rates import PLANNER_FPS as FPS

Array = npt.NDArray[np.float64]

MAX_RATE_RADPS = 0.6
FULL_SPEED_MPS = 0.9
"""At this speed and above the full rate is used; below, proportionally less."""
WALKING_MPS = 0.45
MAX_SIDEWAYS_MPS2 = 1.0
"""Bent windows do not lean: faster motion is bent less, so that a body could perform it upright."""
BENT_SHARE = 0.6
RAMP_FRAMES = 6


def _turn(v: Array, angle: Array) -> Array:
    """Horizontal vectors (..., 2) turned by `angle` (...)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * v[..., 0] - s * v[..., 1], s * v[..., 0] + c * v[..., 1]], axis=-1)


def stance_pivot(features: Features) -> Array:
    """(B, T, 2) place of the standing foot in the root frame of the same frame; the root where no foot stands."""
    joints = features[..., JOINT_POSITIONS].reshape(features.shape[:2] + (21, 3)).astype(np.float64)
    feet = joints[..., CANONICAL.indices(*FOOT_JOINTS) - 1, :2]
    weight = features[..., CONTACTS].astype(np.float64)
    total = weight.sum(-1, keepdims=True)
    return np.where(total > 0, (feet * weight[..., None]).sum(-2) / np.maximum(total, 1e-9), 0.0)


def bend(features: Features, turn_rad: Array) -> Features:
    """Windows whose every frame i is turned, with all that follow, by `turn_rad[:, i]` about the standing foot.

    Args:
        features: (B, T, 263).
        turn_rad: (B, T) extra turn between frames i - 1 and i; column 0 counts for nothing.

    Returns:
        (B, T, 263) new windows; positions in the root frame, rotations and contacts are unchanged.
    """
    out = features.astype(np.float64)
    angle = turn_rad[:, 1:].astype(np.float64)
    pivot = stance_pivot(features)[:, :-1]  # in the root frame of frame i - 1
    yaw = out[:, 1:, 0] / FPS
    step = out[:, 1:, ROOT_VELOCITY] / FPS
    out[:, 1:, ROOT_VELOCITY] = (pivot + _turn(step - pivot, angle)) * FPS
    out[:, 1:, 0] += angle * FPS
    zeros = np.zeros(out.shape[:2] + (1, 3))
    local = np.concatenate([zeros, out[..., JOINT_POSITIONS].reshape(out.shape[:2] + (21, 3))], axis=-2)[..., :2]
    before = local[:, :-1]
    after = _turn(local[:, 1:], yaw[..., None]) + step[..., None, :]
    moved = pivot[..., None, :] + _turn(after - pivot[..., None, :], angle[..., None])
    velocity = _turn(moved - before, -(yaw + angle)[..., None]) * FPS
    v = out[..., JOINT_VELOCITIES].reshape(out.shape[:2] + (22, 3))
    v[:, 1:, :, :2] = velocity
    out[..., JOINT_VELOCITIES] = v.reshape(out.shape[:2] + (-1,))
    return out.astype(np.float32)


def random_turns(features: Features, prefix_frames: int, rng: np.random.Generator) -> Array:
    """(B, T) turns for `bend`: 60 % of the windows that walk or run; from the start on, or setting in near the plan."""
    b, t = features.shape[:2]
    speed = np.linalg.norm(features[..., ROOT_VELOCITY].mean(axis=1), axis=-1)
    chosen = (speed > WALKING_MPS) & (rng.random(b) < BENT_SHARE)
    most = np.minimum(
        MAX_RATE_RADPS * np.minimum(speed / FULL_SPEED_MPS, 1.0), MAX_SIDEWAYS_MPS2 / np.maximum(speed, 0.1)
    )
    rate = rng.uniform(-1.0, 1.0, b) * most * chosen
    begin = np.where(rng.random(b) < 0.5, -RAMP_FRAMES, rng.integers(prefix_frames - 8, prefix_frames + 8, b))
    ramp = np.clip((np.arange(t)[None] - begin[:, None]) / RAMP_FRAMES, 0.0, 1.0)
    return np.asarray(rate[:, None] * ramp / FPS)
