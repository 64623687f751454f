"""Two-bone inverse kinematics of arms and legs on joint positions."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d

from shared.motion.body import SIDES, Array, J, foot_axes, left_axis, runs
from shared.motion.rotations import normalize
from shared.motion.skeleton import CANONICAL

MIN_BEND_RAD = float(np.radians(15.0))
_STRAIGHT_RAD = (np.radians(17.0), np.radians(42.0))
"""Bends between which a limb passes from nearly straight to clearly bent."""
_POLE_SMOOTHING_FRAMES = 3.0
_SOFT_REACH_M = 0.004
_ELBOW_RAD = (1.7, 0.4)
"""Angle about the arm's line up to which an elbow is left where it is, and how much farther it may come."""
_SEEN_M, _CLEAR_M = 0.02, 0.08
"""Offset of an elbow from the arm's line that tells where it points, and what more makes it quite clear."""


def _bones(side: str, middle: str, end: str) -> tuple[float, float]:
    lengths = CANONICAL.bone_lengths_m
    return float(lengths[J[f"{side}_{middle}"]]), float(lengths[J[f"{side}_{end}"]])


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
    # The end of the reach is approached softly, so that a limb that straightens does not stop with a jerk.
    longest = reach(a, b)
    d = longest - _SOFT_REACH_M * np.logaddexp(0.0, (longest - distance) / _SOFT_REACH_M)
    d = np.clip(d, abs(a - b) + 0.02, longest)
    side = pole - np.sum(pole * u, axis=-1, keepdims=True) * u
    along = (a * a - b * b + d * d) / (2 * d)
    out = np.sqrt(np.clip(a * a - along * along, 0.0, None))
    return root + along * u + out * normalize(side), root + d * u


def _steady(offset: Array, natural: Array, a: float, b: float) -> Array:
    """(T, 3) pole of a limb with bones a and b, from the middle joint's offset (T, 3) off the limb's line.

    A bent limb bends where it does. A nearly straight one tells little, and recordings show it bent the wrong way:
    it bends in its `natural` direction, a unit vector (T, 3), leaning toward what the frames around it show.
    """
    size = np.linalg.norm(offset, axis=-1, keepdims=True)
    bend = size * (a + b) / (a * b)
    x = np.clip((bend - _STRAIGHT_RAD[0]) / (_STRAIGHT_RAD[1] - _STRAIGHT_RAD[0]), 0.0, 1.0)
    s = x * x * (3 - 2 * x)
    around = gaussian_filter1d(offset, _POLE_SMOOTHING_FRAMES, axis=0, mode="nearest") if len(offset) > 1 else offset
    return np.asarray(s * normalize(offset) + (1 - s) * normalize(natural + 6.0 * around))


def knee_pole(p: Array, side: str) -> Array:
    """(T, 3) where the knee points: where it is, and forward where the leg is nearly straight."""
    hip, knee, ankle = (p[..., J[f"{side}_{j}"], :] for j in ("hip", "knee", "ankle"))
    u = normalize(ankle - hip)
    offset = knee - hip
    offset = offset - np.sum(offset * u, axis=-1, keepdims=True) * u
    trunk = normalize(p[..., J["spine1"], :] - 0.5 * (p[..., J["left_hip"], :] + p[..., J["right_hip"], :]))
    forward = normalize(np.cross(left_axis(p), trunk)) + foot_axes(p, side)[0]
    natural = normalize(forward - np.sum(forward * u, axis=-1, keepdims=True) * u)
    return _steady(offset, natural, *_bones(side, "knee", "ankle"))


def elbow_pole(p: Array, side: str, relaxed: Array | float = 0.0) -> Array:
    """(T, 3) where the elbow points: where it is, and back, out and down where the arm is nearly straight.

    Args:
        relaxed: share, (T,) or one for all, of the way from where it is to where a relaxed elbow would point.
    """
    shoulder, elbow, wrist = (p[..., J[f"{side}_{j}"], :] for j in ("shoulder", "elbow", "wrist"))
    u = normalize(wrist - shoulder)
    offset = elbow - shoulder
    offset = offset - np.sum(offset * u, axis=-1, keepdims=True) * u
    natural = elbow_rest_direction(p, side, u)
    if offset.ndim == 2 and len(offset) > 1:
        offset = _untwisted(offset, natural, u, relaxed)
    return _steady(offset, natural, *_bones(side, "elbow", "wrist"))


def _untwisted(offset: Array, natural: Array, u: Array, relaxed: Array | float) -> Array:
    """Offsets (T, 3) of an elbow turned about the arm's line `u` to within _ELBOW_RAD of `natural`.

    No upper arm turns all the way round, and where it would pass the far side its twist would jump by a whole turn.
    Recordings show such elbows at the end of a punch. What a stretched arm shows is a mean of what is around it.
    """
    size = np.linalg.norm(offset, axis=-1)
    angle = np.arctan2(np.sum(np.cross(natural, offset) * u, axis=-1), np.sum(natural * offset, axis=-1))
    for a, b in runs(size > _SEEN_M):
        turned = np.unwrap(angle[a:b])
        angle[a:b] = turned - 2 * np.pi * np.round(np.average(turned, weights=size[a:b]) / (2 * np.pi))
    near, room = _ELBOW_RAD
    over = np.clip(np.abs(angle) - near, 0.0, None)
    angle = np.where(
        size > _SEEN_M, np.sign(angle) * (np.minimum(np.abs(angle), near) + room * np.tanh(over / room)), 0
    )
    weight = np.where(size > _SEEN_M, size, 0.0)
    around, total = (gaussian_filter1d(x, _POLE_SMOOTHING_FRAMES, mode="nearest") for x in (angle * weight, weight))
    share = np.clip((size - _SEEN_M) / _CLEAR_M, 0.0, 1.0)
    kept = (1 - np.asarray(relaxed)) * (share * angle + (1 - share) * around / (total + _SEEN_M))
    out = np.cos(kept)[..., None] * natural + np.sin(kept)[..., None] * np.cross(u, natural)
    # Turned away from its natural side a nearly stretched arm must not swing back through a mean of opposite vectors.
    return np.asarray(out * np.maximum(size, _CLEAR_M * np.abs(kept) / near)[..., None])


def elbow_rest_direction(p: Array, side: str, u: Array) -> Array:
    """(T, 3) unit direction, normal to the arm's line `u` (T, 3), in which a relaxed elbow points.

    Back when the arm hangs, down when it reaches forward, up when it is swung backward, back when it is held out.
    """
    outward = normalize(p[..., J["left_shoulder"], :] - p[..., J["right_shoulder"], :])
    outward = outward if side == "left" else -outward
    up = normalize(p[..., J["neck"], :] - p[..., J["spine2"], :])
    up = normalize(up - np.sum(up * outward, axis=-1, keepdims=True) * outward)
    forward = np.cross(outward, up) if side == "left" else np.cross(up, outward)
    u_forward, u_out, u_up = (np.sum(u * axis, axis=-1, keepdims=True) for axis in (forward, outward, up))
    want = (u_up - 1.2 * np.clip(u_out, 0.0, None)) * forward - (u_forward + 0.25) * up + 0.4 * outward
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
