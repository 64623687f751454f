"""Random rotations and poses from a seed, for the property-based tests."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from hypothesis import strategies as st

from shared.motion.kinematics import forward_kinematics
from shared.motion.rotations import matrix_from_axis_angle, matrix_from_quat, matrix_from_rotvec, normalize
from shared.motion.skeleton import CANONICAL

Array = npt.NDArray[np.float64]

seeds = st.integers(0, 2**32 - 1)


def random_quats(rng: np.random.Generator, *shape: int) -> Array:
    """Uniform unit quaternions (*shape, 4)."""
    return normalize(rng.standard_normal((*shape, 4)))


def random_matrices(rng: np.random.Generator, *shape: int) -> Array:
    """Uniform rotations (*shape, 3, 3)."""
    return matrix_from_quat(random_quats(rng, *shape))


def angle_between(a: Array, b: Array) -> Array:
    """Angle (...) in radians of the rotation between two rotations (..., 3, 3), precise near zero."""
    return 2.0 * np.arcsin(np.clip(np.linalg.norm(a - b, axis=(-2, -1)) / np.sqrt(8.0), 0.0, 1.0))


def bent_pose(rng: np.random.Generator, frames: int = 1) -> Array:
    """Local rotations (frames, 22, 3, 3) that a body can take: hinges at knees and elbows bent by 30 to 120 degrees,
    hips and shoulders within 0.6 rad of rest, trunk bent by up to 0.4 rad in all, the other joints at rest."""
    j = CANONICAL
    local = np.broadcast_to(np.eye(3), (frames, len(j), 3, 3)).copy()

    def small(limit: float) -> Array:
        return matrix_from_rotvec(normalize(rng.standard_normal((frames, 3))) * rng.uniform(0, limit, (frames, 1)))

    local[:, j.index("pelvis")] = random_matrices(rng, frames)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        local[:, j.index(f"{side}_hip")] = small(0.6)
        local[:, j.index(f"{side}_shoulder")] = small(0.6)
        bends = np.deg2rad(rng.uniform(30.0, 120.0, (2, frames)))
        local[:, j.index(f"{side}_knee")] = matrix_from_axis_angle(np.tile([0.0, 1.0, 0.0], (frames, 1)), bends[0])
        local[:, j.index(f"{side}_elbow")] = matrix_from_axis_angle(np.tile([0.0, 0.0, -sign], (frames, 1)), bends[1])
    return local


def random_bodies(rng: np.random.Generator, frames: int) -> Array:
    """World positions (frames, 22, 3) of unrelated poses with every joint turned at random."""
    positions, _ = forward_kinematics(CANONICAL, rng.uniform(-3, 3, (frames, 3)), random_matrices(rng, frames, 22))
    return positions


def smooth_motion(rng: np.random.Generator, frames: int, fps: float) -> Array:
    """World positions (frames, 22, 3) of a body that walks about, turns and moves its limbs at up to 2 Hz."""
    t = np.arange(frames) / fps
    local = np.broadcast_to(bent_pose(rng), (frames, 22, 3, 3)).copy()
    heading = rng.uniform(-np.pi, np.pi) + rng.uniform(-2, 2) * t
    local[:, 0] = matrix_from_axis_angle(np.tile([0.0, 0.0, 1.0], (frames, 1)), heading)
    for joint in range(1, 22):
        axis = np.tile(normalize(rng.standard_normal(3)), (frames, 1))
        swing = 0.25 * np.sin(2 * np.pi * rng.uniform(0.2, 2.0) * t + rng.uniform(0, 6))
        local[:, joint] = local[:, joint] @ matrix_from_axis_angle(axis, swing)
    root = np.stack([1.2 * t, 0.3 * np.sin(t), 0.95 + 0.03 * np.sin(4 * t)], axis=-1)
    return forward_kinematics(CANONICAL, root, local)[0]
