"""Forward kinematics of a skeleton and its inverse on the rotation level."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from shared.motion.skeleton import Skeleton

Array = npt.NDArray[np.float64]


def forward_kinematics(skeleton: Skeleton, root_pos_w_m: npt.ArrayLike, local: npt.ArrayLike) -> tuple[Array, Array]:
    """World joint positions and rotations from joint rotations.

    Args:
        skeleton: J joints.
        root_pos_w_m: (..., 3) position of joint 0.
        local: (..., J, 3, 3) rotation of each joint relative to its parent, the root's relative to the world.

    Returns:
        positions_w_m (..., J, 3) and world rotations (..., J, 3, 3).
    """
    local = np.asarray(local, dtype=np.float64)
    root = np.asarray(root_pos_w_m, dtype=np.float64)
    positions = np.empty(local.shape[:-2] + (3,))
    world = np.empty_like(local)
    positions[..., 0, :] = root
    world[..., 0, :, :] = local[..., 0, :, :]
    for joint in range(1, len(skeleton)):
        parent = skeleton.parents[joint]
        world[..., joint, :, :] = world[..., parent, :, :] @ local[..., joint, :, :]
        positions[..., joint, :] = positions[..., parent, :] + world[..., parent, :, :] @ skeleton.offsets_m[joint]
    return positions, world


def local_from_global(skeleton: Skeleton, world: npt.ArrayLike) -> Array:
    """Rotations relative to the parent (..., J, 3, 3) from world rotations (..., J, 3, 3)."""
    world = np.asarray(world, dtype=np.float64)
    parents = np.array(skeleton.parents)
    parents[0] = 0
    local = np.swapaxes(world[..., parents, :, :], -1, -2) @ world
    local[..., 0, :, :] = world[..., 0, :, :]
    return local
