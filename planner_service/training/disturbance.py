"""Prefixes as the closed loop has them: tracking error, and its decay into the part of the old plan still to be played.

What is simulated is off the plan by centimetres; the orchestrator adds the present error, decaying, to the rest of
the old plan (DESIGN 6). So a window is moved by a smooth offset of each joint that holds, then fades; a little noise
lies on its prefix.

A planner's own motion swings less than what it learnt from, and is what it goes on from: a wave that has once become
small stays small. So the arms of some prefixes swing less than recorded, and the plan goes back to the recorded swing.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter1d

from planner_service.training.windows import Features, ik_6d, rotations_of, window_features, window_positions
from shared.motion.skeleton import CANONICAL

Array = npt.NDArray[np.float64]

ROOT_OFFSET_M = (0.02, 0.02, 0.008)
BONE_OFFSET_M = 0.007
YAW_OFFSET_RAD = 0.03
NOISE_M = 0.002
SETTLE_FRAMES = 10
"""Frames after the prefix in which an offset that still holds at its end fades to nothing."""
STILLED_SHARE = 0.5
"""Of the disturbed windows, those whose arms swing less in the prefix."""
LEAST_STILLED = 0.3
SWING_FRAMES = 6.0
"""Standard deviation of the Gaussian mean that a stilled arm is drawn to: it leaves 2 % of a swing at 1.5 Hz."""
ARMS = tuple((CANONICAL.index(f"{side}_elbow"), CANONICAL.index(f"{side}_wrist")) for side in ("left", "right"))


def random_offsets(positions_w_m: Array, prefix_frames: int, rng: np.random.Generator) -> Array:
    """(B, T, 22, 3) smooth offsets plus prefix noise for windows (B, T, 22, 3)."""
    b, t = positions_w_m.shape[:2]
    size = rng.gamma(2.0, 0.5, size=(b, 1, 1))
    offset = np.zeros((b, 22, 3))
    offset[:, 0] = rng.normal(size=(b, 3)) * ROOT_OFFSET_M
    for joint in range(1, 22):
        offset[:, joint] = offset[:, CANONICAL.parents[joint]] + BONE_OFFSET_M * rng.normal(size=(b, 3))
    offset *= size
    yaw = YAW_OFFSET_RAD * rng.normal(size=b) * size[:, 0, 0]

    frame = np.arange(t)[None]
    hold = rng.integers(prefix_frames // 3, prefix_frames + 1, size=(b, 1))
    decay = rng.uniform(2.0, 6.0, size=(b, 1))
    profile = np.exp(-np.maximum(frame - hold, 0) / decay)
    end = np.clip((prefix_frames + SETTLE_FRAMES - frame) / SETTLE_FRAMES, 0.0, 1.0)
    profile = profile * end * end * (3 - 2 * end)
    sway = 1.0 + 0.4 * np.sin(2 * np.pi * (rng.uniform(0.01, 0.1, size=(b, 1)) * frame + rng.random((b, 1))))
    profile = (profile * sway)[..., None]

    arm = positions_w_m - positions_w_m[:, :, :1]
    turned = np.stack([-arm[..., 1], arm[..., 0], np.zeros_like(arm[..., 0])], axis=-1) * yaw[:, None, None, None]
    out = (offset[:, None] + turned) * profile[..., None]
    noise = rng.normal(size=(b, prefix_frames, 22, 3)) * (NOISE_M * rng.random((b, 1, 1, 1)))
    out[:, :prefix_frames] += noise
    return np.asarray(out)


def stilled_arms(positions_w_m: Array, prefix_frames: int, rng: np.random.Generator) -> Array:
    """Windows (B, T, 22, 3) whose arms, seen from the shoulder, move less in the prefix; bones keep their length.

    The share of the swing that is lost is LEAST_STILLED or more, to all of it, and falls to nothing within
    SETTLE_FRAMES of the plan.
    """
    b, t = positions_w_m.shape[:2]
    lost = rng.uniform(LEAST_STILLED, 1.0, size=(b, 1))
    fade = np.clip((prefix_frames + SETTLE_FRAMES - np.arange(t)) / SETTLE_FRAMES, 0.0, 1.0)
    lost = (lost * fade * fade * (3 - 2 * fade))[..., None]
    out = positions_w_m.copy()
    for elbow, wrist in ARMS:
        shoulder = CANONICAL.parents[elbow]
        for joint, parent in ((elbow, shoulder), (wrist, elbow)):
            bone = positions_w_m[:, :, joint] - positions_w_m[:, :, parent]
            length = np.linalg.norm(bone, axis=-1, keepdims=True)
            calm = bone + lost * (gaussian_filter1d(bone, SWING_FRAMES, axis=1, mode="nearest") - bone)
            out[:, :, joint] = out[:, :, parent] + calm * (length / np.linalg.norm(calm, axis=-1, keepdims=True))
    return out


def disturb(features: Features, prefix_frames: int, rng: np.random.Generator) -> Features:
    """Windows (B, T, 263) with a disturbed prefix and a plan that settles from it; rotations by IK as in use."""
    positions = window_positions(features)
    rotations = rotations_of(features)
    changed = prefix_frames + SETTLE_FRAMES
    rows = np.flatnonzero(rng.random(len(positions)) < STILLED_SHARE)
    positions[rows] = stilled_arms(positions[rows], prefix_frames, rng)
    positions = positions + random_offsets(positions, prefix_frames, rng)
    rotations[:, :changed] = ik_6d(positions[:, :changed])
    return window_features(positions, rotations)
