"""Rotations of a motion that comes as positions only, fitted to its bones."""

from __future__ import annotations

import numpy as np

from shared.motion.io.landmarks import Array
from shared.motion.rotations import matrix_between, normalize

_LEAST = 1e-6


def fit_rotations(parents: tuple[int, ...], offsets: Array, positions: Array) -> Array:
    """World rotations (T, J, 3, 3) that take the bones of the zero pose to those of the motion.

    A joint with several bones turns as they do together (Kabsch); one with a single bone takes the shortest turn from
    its parent's attitude, since nothing shows its twist; one without bones is held by its parent.

    Args:
        offsets: (J, 3) from the parent in the zero pose. positions: (T, J, 3).
    """
    frames, joints = positions.shape[:2]
    children: list[list[int]] = [[] for _ in range(joints)]
    for joint, parent in enumerate(parents):
        if parent >= 0 and np.linalg.norm(offsets[joint]) > _LEAST:
            children[parent].append(joint)
    out = np.empty((frames, joints, 3, 3))
    for joint, parent in enumerate(parents):
        held = out[:, parent] if parent >= 0 else np.broadcast_to(np.eye(3), (frames, 3, 3))
        bones = children[joint]
        if not bones:
            out[:, joint] = held
            continue
        rest = normalize(offsets[bones])
        now = normalize(positions[:, bones] - positions[:, joint, None])
        if np.linalg.matrix_rank(rest, tol=0.05) < 2:
            out[:, joint] = matrix_between(held @ rest[0], now[:, 0]) @ held
            continue
        u, _, vt = np.linalg.svd(np.einsum("tbi,bj->tij", now, rest))
        flip = np.ones((frames, 3))
        flip[:, 2] = np.linalg.det(u @ vt)
        out[:, joint] = (u * flip[:, None]) @ vt
    return out
