"""Where a body's weight is, and bodies put over their feet: legs that reach, trunks that lean."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from shared.motion.body import SIDES, Array, J, forward_of
from shared.motion.kinematics import forward_kinematics
from shared.motion.limbs import reach, solve_leg, unlock_arms
from shared.motion.rotations import matrix_from_axis_angle
from shared.motion.skeleton import CANONICAL

_SEGMENTS: tuple[tuple[str, str, float, float], ...] = (
    ("pelvis", "spine3", 0.55, 0.497), ("neck", "head", 0.7, 0.081),
    *((f"{s}_{a}", f"{s}_{b}", at, share) for s in SIDES for a, b, at, share in (
        ("shoulder", "elbow", 0.44, 0.028), ("elbow", "wrist", 0.68, 0.022), ("hip", "knee", 0.43, 0.100),
        ("knee", "ankle", 0.43, 0.0465), ("ankle", "foot", 0.4, 0.0145))),
)  # fmt: skip
"""Joints, where the mass lies between them, and its share of the whole (Winter, Biomechanics, table 4.1)."""

_UPPER_SHARE = 0.68
_TRUNK_ARM_M = 0.33
_MAX_LEAN_RAD = 0.6
_FARTHEST_RAD = 0.95
"""Inclination of the trunk beyond which nobody bends to sit down; the rest is momentum."""


def centre_of_mass(p: Array) -> Array:
    """(T, 3) centre of mass of poses (T, 22, 3)."""
    parts = [share * ((1 - at) * p[:, J[a]] + at * p[:, J[b]]) for a, b, at, share in _SEGMENTS]
    return np.asarray(np.sum(parts, axis=0) / sum(share for *_, share in _SEGMENTS))


def ahead_of_feet(p: Array, point: Array) -> Array:
    """(T,) how far points (T, 3) lie ahead of the middle between the ankles, along where the pelvis faces."""
    middle = 0.5 * (p[:, J["left_ankle"], :2] + p[:, J["right_ankle"], :2])
    return np.asarray(np.sum((point[:, :2] - middle) * forward_of(p)[:, :2], axis=-1))


def on_feet(local: Array, root: Array, ankles: dict[str, Array], feet: dict[str, Array], lower: bool = True) -> Array:
    """(T, 22, 3) poses over given feet.

    Args:
        local: (T, 22, 3, 3) local rotations, the root's in the world; root: (T, 3) of the pelvis.
        ankles, feet: of each side, (T, 3) places of the ankles and vectors from ankle to ball of the foot.
        lower: whether the pelvis sinks where a leg would not reach.
    """
    p, _ = forward_kinematics(CANONICAL, root, local)
    if lower:
        need = np.zeros(len(p))
        lengths = CANONICAL.bone_lengths_m
        longest = reach(float(lengths[J["left_knee"]]), float(lengths[J["left_ankle"]])) - 0.006
        for side in SIDES:
            gap = p[:, J[f"{side}_hip"]] - ankles[side]
            flat = np.sum(gap[:, :2] ** 2, axis=-1)
            need = np.maximum(need, gap[:, 2] - np.sqrt(np.clip(longest**2 - flat, 0.01, None)))
        need = gaussian_filter1d(maximum_filter1d(np.clip(need, 0.0, 0.25), 9), 3.0, mode="nearest")
        p = p - np.stack([np.zeros_like(need), np.zeros_like(need), need], axis=-1)[:, None]
    for side in SIDES:
        # The foot's direction is set before the leg is solved: it tells where a nearly straight knee points.
        p[:, J[f"{side}_foot"]] = p[:, J[f"{side}_ankle"]] + feet[side]
        p = solve_leg(p, side, ankles[side])
        p[:, J[f"{side}_foot"]] = p[:, J[f"{side}_ankle"]] + feet[side]
    return unlock_arms(p)


def leaned(local: Array, lean_rad: Array) -> Array:
    """Local rotations with the trunk inclined forward by angles (T,): half at the hips, half along the spine."""
    out = local.copy()
    x = local[:, 0, :, 1]
    flat = np.stack([x[:, 0], x[:, 1], np.zeros(len(x))], axis=-1)
    out[:, 0] = (
        matrix_from_axis_angle(flat / np.linalg.norm(flat, axis=-1, keepdims=True), 0.5 * lean_rad) @ local[:, 0]
    )
    y = np.array([0.0, 1.0, 0.0])
    for name, part in (("spine1", 0.25), ("spine2", 0.25), ("neck", -0.5)):
        out[:, J[name]] = out[:, J[name]] @ matrix_from_axis_angle(y, part * lean_rad)
    return out


def lean_over_feet(
    local: Array, root: Array, ankles: dict[str, Array], feet: dict[str, Array], free: Array,
    room_m: tuple[float, float] = (-0.05, 0.11),
) -> Array:  # fmt: skip
    """Local rotations with the trunk leaned so that the centre of mass is over the feet where they alone carry it.

    Args:
        free: (T,) 1 where the feet carry the body, 0 where something else does, and between.
        room_m: how far behind and ahead of the ankles it may be.
    """
    lean = np.zeros(len(local))
    for _ in range(4):
        p = on_feet(leaned(local, lean), root, ankles, feet, lower=False)
        at = ahead_of_feet(p, centre_of_mass(p))
        wrong = np.clip(room_m[0] - at, 0.0, None) - np.clip(at - room_m[1], 0.0, None)
        lean = np.clip(lean + free * wrong / (_UPPER_SHARE * _TRUNK_ARM_M), -0.5, _MAX_LEAN_RAD)
        up = p[:, J["neck"]] - p[:, J["pelvis"]]
        over = np.arccos(np.clip(up[:, 2] / np.linalg.norm(up, axis=-1), -1.0, 1.0)) - _FARTHEST_RAD
        lean = lean - np.clip(over, 0.0, None)
    return leaned(local, gaussian_filter1d(lean, 4.0, mode="nearest"))
