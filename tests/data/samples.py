"""Motion for the tests that needs no recording."""

from __future__ import annotations

import numpy as np

from shared.motion.body import Array, J
from shared.motion.ik import standing_clip, standing_pose
from shared.motion.kinematics import forward_kinematics
from shared.motion.limbs import solve_leg
from shared.motion.skeleton import CANONICAL


def stand(frames: int = 60) -> Array:
    """(frames, 22, 3) a relaxed stand with the knees a little bent, facing +X."""
    p = standing_clip(frames, 30.0).positions_w_m
    feet = {side: p[:, J[f"{side}_ankle"]].copy() for side in ("left", "right")}
    p = p - [0.0, 0.0, 0.02]
    for side, at in feet.items():
        p = solve_leg(p, side, at)
    return p


def stepping(frames: int = 120, speed: float = 1.0) -> Array:
    """(frames, 22, 3) a plain walk along +X: feet planted half of each second, swinging the other half."""
    t = np.arange(frames) / 30.0
    local = np.repeat(standing_pose()[None], frames, axis=0)
    root = np.stack([speed * t, 0.0 * t, np.full(frames, CANONICAL.root_height_m - 0.05)], axis=-1)
    p, _ = forward_kinematics(CANONICAL, root, local)
    for side, phase in (("left", 0.0), ("right", 0.5)):
        cycle = t + phase
        whole, part = np.floor(cycle), cycle % 1.0
        swing = np.clip((part - 0.5) / 0.5, 0.0, 1.0)
        ease = swing * swing * (3 - 2 * swing)
        x = speed * (whole - phase + ease) + 0.25 * speed
        z = 0.0683 + 0.08 * np.sin(np.pi * swing) ** 2
        y = p[:, J[f"{side}_ankle"], 1]
        p = solve_leg(p, side, np.stack([x, y, z], axis=-1))
    return p
