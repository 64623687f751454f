"""Parts of a goal as the arrays of a PlanRequest."""

from __future__ import annotations

import numpy as np

from shared.motion.skeleton import CANONICAL
from shared.tasks.interface import PlanGoal


def keyframe_arrays(goal: PlanGoal) -> dict[str, np.ndarray]:
    """Keyframes of a goal, places and rotations with their masks; empty when there are none."""
    count = len(goal.keyframe_ticks)
    if not count:
        return {}
    arrays: dict[str, np.ndarray] = {"keyframe_ticks": np.array(goal.keyframe_ticks, "<i8")}
    named = zip(goal.keyframe_joints, goal.keyframe_positions_w_m, strict=True)
    places = [dict(zip(joints, points, strict=True)) for joints, points in named]
    turns = goal.keyframe_rotations_6d or ({},) * count
    for name, frames, width in (("positions_w_m", places, 3), ("rotations_6d", turns, 6)):
        mask, values = np.zeros((count, len(CANONICAL)), "|u1"), np.zeros((count, len(CANONICAL), width), "<f4")
        for k, frame in enumerate(frames):
            for joint, value in frame.items():
                mask[k, CANONICAL.index(joint)] = 1
                values[k, CANONICAL.index(joint)] = value
        arrays[f"keyframe_{name}"] = values
        arrays["keyframe_mask" if width == 3 else "keyframe_rotation_mask"] = mask
    return arrays


def obstacle_arrays(goal: PlanGoal) -> dict[str, np.ndarray]:
    """What a goal keeps away from; empty when there is nothing."""
    if not goal.obstacles:
        return {}
    return {
        "obstacle_pos_w_m": np.array([each.position_w_m for each in goal.obstacles], "<f4"),
        "obstacle_linvel_w_mps": np.array([each.velocity_w_mps for each in goal.obstacles], "<f4"),
        "obstacle_radius_m": np.array([each.radius_m for each in goal.obstacles], "<f4"),
    }
