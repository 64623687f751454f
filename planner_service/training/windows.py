"""Windows of features and world positions, many at once: the array forms of G2R and R2G that training needs.

Shapes: B windows, T frames, 22 joints, 263 features at 20 fps.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import torch

from planner_service.dip.features_torch import plan_to_positions
from shared.motion.features import (
    CONTACTS,
    JOINT_ROTATIONS,
    JOINT_VELOCITIES,
    ROOT_VELOCITY,
    YAW_RATE,
    global_to_features,
)
from shared.motion.ik import rotations_from_positions
from shared.motion.metrics import CONTACT_HEIGHT_M, CONTACT_SPEED_MPS, FOOT_JOINTS, sole_points
from shared.motion.rotations import matrix_to_6d
from shared.motion.skeleton import CANONICAL
from shared.protocol.rates import PLANNER_FPS as FPS

Array = npt.NDArray[np.float64]
Features = npt.NDArray[np.float32]


def window_positions(features: npt.ArrayLike) -> Array:
    """R2G of windows (B, T, 263) -> (B, T, 22, 3), frame 0 at the origin, facing +X."""
    rates = np.array(features, dtype=np.float64)
    rates[:, 0, YAW_RATE] = 0.0
    rates[:, 0, ROOT_VELOCITY] = 0.0
    return plan_to_positions(torch.from_numpy(rates), FPS)[0].numpy()


def ik_6d(positions_w_m: npt.ArrayLike) -> Array:
    """Local rotations (..., 22, 6) from positions (..., 22, 3)."""
    p = np.asarray(positions_w_m, dtype=np.float64)
    return matrix_to_6d(rotations_from_positions(p.reshape(-1, 22, 3))).reshape(p.shape[:-1] + (6,))


def window_features(positions_w_m: Array, rotations_6d: Array) -> Features:
    """G2R of windows (B, T, 22, 3) with known local rotations (B, T, 22, 6) -> (B, T, 263).

    As `global_to_features` of every window by itself: its first row repeats the rates of its second.
    """
    b, t = positions_w_m.shape[:2]
    flat = global_to_features(positions_w_m.reshape(-1, 22, 3), FPS, rotations_6d=rotations_6d.reshape(-1, 22, 6))
    return repeat_first_rates(flat.reshape(b, t, -1).astype(np.float32), positions_w_m[:, 0])


def repeat_first_rates(features: Features, first_positions_w_m: Array) -> Features:
    """Windows cut from longer motion, their first row's rates, velocities and contacts made as G2R makes them.

    Args:
        features: (B, T, 263), changed in place.
        first_positions_w_m: (B, 22, 3) positions of each window's first frame (heights are what counts).
    """
    for part in (YAW_RATE, ROOT_VELOCITY):
        features[:, 0, part] = features[:, 1, part]
    # The velocity of row 1 is seen from row 1's heading; row 0 sees the same world velocity from its own.
    angle = features[:, 1, 0].astype(np.float64) / FPS
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    v = features[:, 1, JOINT_VELOCITIES].reshape(len(features), 22, 3).astype(np.float64)
    turned = np.stack([c * v[..., 0] - s * v[..., 1], s * v[..., 0] + c * v[..., 1], v[..., 2]], axis=-1)
    features[:, 0, JOINT_VELOCITIES] = turned.reshape(len(features), -1)
    speed = np.linalg.norm(v[:, CANONICAL.indices(*FOOT_JOINTS)], axis=-1)
    low = sole_points(first_positions_w_m)[..., 2] < CONTACT_HEIGHT_M
    features[:, 0, CONTACTS] = (low & (speed < CONTACT_SPEED_MPS)).astype(np.float32)
    return features


def rotations_of(features: Features) -> Array:
    """Local rotations (B, T, 22, 6) that windows carry; the root's is the identity (G2R does not use it)."""
    b, t = features.shape[:2]
    out = np.zeros((b, t, 22, 6))
    out[..., 0, 0] = out[..., 0, 4] = 1.0
    out[..., 1:, :] = features[..., JOINT_ROTATIONS].reshape(b, t, 21, 6)
    return out
