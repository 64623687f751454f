"""Reward terms of motion tracking, one pure function each (after slim PHC, REFERENCE 2). The reference is the clip or
plan that was asked for, never another one."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

F32 = npt.NDArray[np.float32]


def position_reward(pos_w_m: F32, ref_w_m: F32) -> F32:
    """0.4 exp(-100 d) + 0.1 exp(-10 d) of the mean squared distance d of body positions (B, J, 3) -> (B,).

    The second, wider term leads back from where the first is flat: a limb half a metre off in a kick, a body that gets
    up otherwise than it was shown.
    """
    d = np.mean(np.sum((pos_w_m - ref_w_m) ** 2, axis=-1), axis=-1)
    return np.asarray(0.4 * np.exp(-100.0 * d) + 0.1 * np.exp(-10.0 * d), dtype=np.float32)


def rotation_reward(rot_xy: F32, ref_xy: F32) -> F32:
    """exp(-10 x mean squared angle) of body rotations given by two columns (B, J, 2, 3) -> (B,)."""
    dots = rot_xy @ ref_xy.swapaxes(-1, -2)  # (B, J, 2, 2)
    third = dots[..., 0, 0] * dots[..., 1, 1] - dots[..., 0, 1] * dots[..., 1, 0]
    cosine = np.clip((dots[..., 0, 0] + dots[..., 1, 1] + third - 1.0) / 2.0, -1.0, 1.0)
    return np.asarray(np.exp(-10.0 * np.mean(np.arccos(cosine) ** 2, axis=-1)), dtype=np.float32)


def velocity_reward(vel_w_mps: F32, ref_w_mps: F32) -> F32:
    """exp(-1 x mean squared difference) of body velocities (B, J, 3) -> (B,)."""
    return np.asarray(np.exp(-np.mean(np.sum((vel_w_mps - ref_w_mps) ** 2, axis=-1), axis=-1)), dtype=np.float32)


def hinge_rate_reward(rate_radps: F32, ref_radps: F32) -> F32:
    """exp(-0.1 x mean squared difference) of hinge rates (B, H) -> (B,)."""
    return np.asarray(np.exp(-0.1 * np.mean((rate_radps - ref_radps) ** 2, axis=-1)), dtype=np.float32)


def smoothness_cost(action: F32, previous: F32) -> F32:
    """Mean squared change of the action (B, H) since the tick before -> (B,)."""
    return np.asarray(np.mean((action - previous) ** 2, axis=-1), dtype=np.float32)
