"""Two-bone inverse kinematics of arms and legs on joint positions."""

from __future__ import annotations

import numpy as np

from shared.data.body import SIDES, Array, J, foot_axes, forward_of, left_axis
from shared.motion.rotations import normalize
from shared.motion.skeleton import CANONICAL

MIN_BEND_RAD = float(np.radians(15.0))
_POLE_BIAS_M = 0.02


def reach(a: float, b: float, bend: float = MIN_BEND_RAD) -> float:
    """Distance between the ends of two bones that are `bend` short of straight."""
    return float(np.sqrt(a * a + b * b + 2 * a * b * np.cos(bend)))


def two_bone(root: Array, target: Array, a: float, b: float, pole: Array) -> tuple[Array, Array]:
    """Middle and end joints (..., 3) of bones of length a and b from `root` toward `target`.

    The middle joint lies on the side of `pole` (a direction, need not be normal to the limb). A target out of reach
    is approached as far as the least bend (MIN_BEND_RAD) allows; one too close is kept at |a - b| plus a margin.
    """
    line = target - root
    distance = np.linalg.norm(line, axis=-1, keepdims=True)
    u = normalize(line)
    d = np.clip(distance, abs(a - b) + 0.02, reach(a, b))
    side = pole - np.sum(pole * u, axis=-1, keepdims=True) * u
    along = (a * a - b * b + d * d) / (2 * d)
    out = np.sqrt(np.clip(a * a - along * along, 0.0, None))
    return root + along * u + out * normalize(side), root + d * u


def knee_pole(p: Array, side: str) -> Array:
    """(T, 3) where the knee points: where it is, and forward where the leg is nearly straight."""
    hip, knee, ankle = (p[..., J[f"{side}_{j}"], :] for j in ("hip", "knee", "ankle"))
    u = normalize(ankle - hip)
    offset = knee - hip
    offset = offset - np.sum(offset * u, axis=-1, keepdims=True) * u
    trunk = normalize(p[..., J["spine1"], :] - 0.5 * (p[..., J["left_hip"], :] + p[..., J["right_hip"], :]))
    forward = normalize(np.cross(left_axis(p), trunk)) + foot_axes(p, side)[0]
    return offset + _POLE_BIAS_M * normalize(forward - np.sum(forward * u, axis=-1, keepdims=True) * u)


def elbow_pole(p: Array, side: str) -> Array:
    """(T, 3) where the elbow points: where it is, and back, out and down where the arm is nearly straight."""
    shoulder, elbow, wrist = (p[..., J[f"{side}_{j}"], :] for j in ("shoulder", "elbow", "wrist"))
    u = normalize(wrist - shoulder)
    offset = elbow - shoulder
    offset = offset - np.sum(offset * u, axis=-1, keepdims=True) * u
    return offset + _POLE_BIAS_M * elbow_rest_direction(p, side, u)


def elbow_rest_direction(p: Array, side: str, u: Array) -> Array:
    """(T, 3) unit direction, normal to the arm's line `u`, in which a relaxed elbow points."""
    outward = normalize(p[..., J["left_shoulder"], :] - p[..., J["right_shoulder"], :])
    outward = outward if side == "left" else -outward
    up = normalize(p[..., J["neck"], :] - p[..., J["spine2"], :])
    forward = forward_of(p)
    want = -0.6 * forward + 0.5 * outward - 0.6 * up
    return normalize(want - np.sum(want * u, axis=-1, keepdims=True) * u)


def solve_leg(p: Array, side: str, ankle_target: Array) -> Array:
    """Poses with one leg's ankle at (T, 3) `ankle_target` as far as it reaches; the foot keeps its direction."""
    out = p.copy()
    hip, knee, ankle, foot = (J[f"{side}_{j}"] for j in ("hip", "knee", "ankle", "foot"))
    lengths = CANONICAL.bone_lengths_m
    out[:, knee], out[:, ankle] = two_bone(
        p[:, hip], ankle_target, float(lengths[knee]), float(lengths[ankle]), knee_pole(p, side)
    )
    out[:, foot] = out[:, ankle] + (p[:, foot] - p[:, ankle])
    return out


def solve_arm(p: Array, side: str, wrist_target: Array, pole: Array | None = None) -> Array:
    """Poses with one arm's wrist at (T, 3) `wrist_target` as far as it reaches."""
    out = p.copy()
    shoulder, elbow, wrist = (J[f"{side}_{j}"] for j in ("shoulder", "elbow", "wrist"))
    lengths = CANONICAL.bone_lengths_m
    out[:, elbow], out[:, wrist] = two_bone(
        p[:, shoulder],
        wrist_target,
        float(lengths[elbow]),
        float(lengths[wrist]),
        elbow_pole(p, side) if pole is None else pole,
    )
    return out


def unlock_arms(p: Array) -> Array:
    """Both arms with at least the least bend at the elbow."""
    for side in SIDES:
        p = solve_arm(p, side, p[:, J[f"{side}_wrist"]])
    return p


def bends_rad(p: Array) -> dict[str, Array]:
    """Bend of each knee and elbow (T,), zero when straight."""
    out = {}
    for upper, mid, lower in (("hip", "knee", "ankle"), ("shoulder", "elbow", "wrist")):
        for side in SIDES:
            u = normalize(p[:, J[f"{side}_{mid}"]] - p[:, J[f"{side}_{upper}"]])
            v = normalize(p[:, J[f"{side}_{lower}"]] - p[:, J[f"{side}_{mid}"]])
            out[f"{side}_{mid}"] = np.arccos(np.clip(np.sum(u * v, axis=-1), -1.0, 1.0))
    return out
