"""Retargeting of any skeleton with legs to the canonical one.

Trunk, head, collars and feet copy the source's segment rotations, corrected by a constant (the calibration) that
makes the source's neutral pose the canonical one; limbs copy the directions of the source's bones. Bone lengths are
the canonical ones, the path of the hips is scaled by the ratio of leg lengths.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from shared.errors import InvalidInputError
from shared.motion.body import SIDES, Array, Bools, J
from shared.motion.io.landmarks import leg_length
from shared.motion.io.raw import RawMotion
from shared.motion.rotations import (
    matrix_between,
    matrix_from_quat,
    normalize,
    quat_from_matrix,
    quat_slerp,
)
from shared.motion.skeleton import CANONICAL
from shared.protocol.rates import CORPUS_FPS as FPS

_LEG_M = float(CANONICAL.bone_lengths_m[J["left_knee"]] + CANONICAL.bone_lengths_m[J["left_ankle"]])
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Calibration:
    """For one source skeleton: canonical segment rotation = source rotation @ constant; and leg length."""

    segments: dict[str, Array]
    leg_m: float


def _heading_frame(left: Array) -> Array:
    """(..., 3, 3) upright frame whose Y axis is the horizontal part of `left`."""
    y = normalize(left * np.array([1.0, 1.0, 0.0]))
    z = np.broadcast_to(_UP, y.shape)
    return np.stack([np.cross(y, z), y, z], axis=-1)


def _square_frame(up: Array, ahead: Array) -> Array:
    """(..., 3, 3) frame whose Z axis is `up` and whose X axis is the part of `ahead` at a right angle to it."""
    z = normalize(up)
    y = normalize(np.cross(z, ahead))
    return np.stack([np.cross(y, z), y, z], axis=-1)


def _mean_rotation(m: Array) -> Array:
    """Chordal mean (3, 3) of rotations (N, 3, 3)."""
    u, _, vt = np.linalg.svd(m.mean(axis=0))
    return np.asarray(u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt)


def _rest_is_standing(raw: RawMotion, marks: dict[str, int]) -> bool:
    """Whether the file's zero pose is a person standing upright with arms anywhere."""
    rest = raw.rest_positions_m
    legs = normalize(np.stack([rest[marks[f"{s}_ankle"]] - rest[marks[f"{s}_hip"]] for s in SIDES]))
    top = marks.get("head", marks.get("neck", 0))
    hips = 0.5 * (rest[marks["left_hip"]] + rest[marks["right_hip"]])
    width = rest[marks["left_hip"]] - rest[marks["right_hip"]]
    trunk = normalize(rest[top] - hips)
    return bool((legs[:, 2] < -0.8).all() and trunk[2] > 0.9 and abs(width[2]) < 0.3 * np.linalg.norm(width))


def calibrate(raws: Sequence[RawMotion]) -> Calibration:
    """Calibration of one skeleton from its zero pose where that stands upright, else from its upright frames.

    The pitch of the feet is then corrected by what the planted feet show.
    """
    marks, segments = raws[0].landmarks(), raws[0].segmented()
    if raws[0].rotations_w is None:
        raise InvalidInputError(f"{raws[0].source}: no rotations to calibrate on", field="path")
    leg = float(np.mean([leg_length(r.positions_w_m, marks) for r in raws]))
    out: dict[str, Array] = {}
    if _rest_is_standing(raws[0], marks):
        rest = raws[0].rest_positions_m
        heading = _heading_frame(rest[marks["left_hip"]] - rest[marks["right_hip"]])
        for name in segments:
            out[name] = heading
            if name.endswith("_foot"):
                side = name.removesuffix("_foot")
                shank = rest[marks[f"{side}_ankle"]] - rest[marks[f"{side}_knee"]]
                # The neutral foot is at a right angle to the shank; legs spread in the zero pose are closed first.
                out[name] = matrix_between(shank, -_UP).T @ heading
    else:
        out = _calibrate_upright(raws, marks, segments)
    out = _settle_upper(raws, segments, out)
    return Calibration(_level_feet(raws, marks, segments, out), leg)


def _joint(raw: RawMotion, raws: Sequence[RawMotion], joint: int) -> int:
    """Index in `raw` of what is `joint` in the first motion: files of one skeleton may order the joints differently."""
    name = raws[0].names[joint]
    return joint if raw.names[joint] == name else raw.names.index(name)


def _stack(raws: Sequence[RawMotion], joint: int) -> Array:
    return np.concatenate([r.positions_w_m[:, _joint(r, raws, joint)] for r in raws])


def _rotations(raws: Sequence[RawMotion], joint: int) -> Array:
    return np.concatenate([r.rotations_w[:, _joint(r, raws, joint)] for r in raws if r.rotations_w is not None])


def _settle_upper(raws: Sequence[RawMotion], segments: dict[str, int], constants: dict[str, Array]) -> dict[str, Array]:
    """Where a head or collar is turned over a right angle from the chest on average, the file's zero pose of it is
    arbitrary (some exporters turn it round): its mean attitude is then taken as that of the chest."""
    out = dict(constants)
    if "chest" not in segments:
        return out
    chest = _rotations(raws, segments["chest"]) @ constants["chest"]
    for name in ("head", "left_collar", "right_collar"):
        if name not in segments:
            continue
        g = _rotations(raws, segments[name])
        mean = _mean_rotation(np.swapaxes(chest, -1, -2) @ g @ constants[name])
        if np.trace(mean) < 1.0:
            out[name] = _mean_rotation(np.swapaxes(g, -1, -2) @ chest)
    return out


def _calibrate_upright(raws: Sequence[RawMotion], marks: dict[str, int], segments: dict[str, int]) -> dict[str, Array]:
    hips = 0.5 * (_stack(raws, marks["left_hip"]) + _stack(raws, marks["right_hip"]))
    top = _stack(raws, marks.get("neck", marks.get("head", segments["pelvis"])))
    trunk = normalize(top - hips)
    ankle = np.minimum(_stack(raws, marks["left_ankle"])[:, 2], _stack(raws, marks["right_ankle"])[:, 2])
    tall = hips[:, 2] - ankle
    upright = (trunk[:, 2] > np.cos(np.radians(15.0))) & (tall > 0.95 * np.percentile(tall, 80))
    if upright.sum() < 5:
        upright = trunk[:, 2] >= np.sort(trunk[:, 2])[-min(5, len(trunk))]
    across = {"pelvis": _stack(raws, marks["left_hip"]) - _stack(raws, marks["right_hip"])}
    if "left_shoulder" in marks:
        across["chest"] = _stack(raws, marks["left_shoulder"]) - _stack(raws, marks["right_shoulder"])
    out = {}
    for name, joint in segments.items():
        g = _rotations(raws, joint)
        side = name.removesuffix("_foot")
        if f"{side}_toe" in marks:
            ankle_at = _stack(raws, marks[f"{side}_ankle"])
            toe = _stack(raws, marks[f"{side}_toe"]) - ankle_at
            planted = _planted(raws, marks, side)
            if planted.any():
                frame = _heading_frame(np.cross(_UP, toe))
            else:
                # It never stands on that foot: on average it is held at a right angle to the shank.
                planted = np.ones_like(planted)
                frame = _square_frame(_stack(raws, marks[f"{side}_knee"]) - ankle_at, toe)
            out[name] = _mean_rotation(np.swapaxes(g[planted], -1, -2) @ frame[planted])
        else:
            low = name == "pelvis" or name.endswith("_foot")
            frame = _heading_frame(across.get("pelvis" if low else "chest", across["pelvis"]))
            out[name] = _mean_rotation(np.swapaxes(g[upright], -1, -2) @ frame[upright])
    return out


def _planted(raws: Sequence[RawMotion], marks: dict[str, int], side: str) -> Bools:
    """Frames (all takes, concatenated) in which a foot is low and slow; none where they are fewer than five."""
    out = []
    for raw in raws:
        p = raw.positions_w_m[:, _joint(raw, raws, marks[f"{side}_ankle"])]
        twin = "right_ankle" if side == "left" else "left_ankle"
        other = raw.positions_w_m[:, _joint(raw, raws, marks[twin]), 2]
        speed = np.linalg.norm(np.gradient(p, axis=0) * raw.fps, axis=-1) if len(p) > 1 else np.zeros(len(p))
        floor = np.percentile(np.minimum(p[:, 2], other), 10)
        out.append((speed < 0.15) & (p[:, 2] < floor + 0.04))
    mask = np.concatenate(out)
    return mask if mask.sum() >= 5 else np.zeros(len(mask), dtype=bool)


def _level_feet(
    raws: Sequence[RawMotion], marks: dict[str, int], segments: dict[str, int], constants: dict[str, Array]
) -> dict[str, Array]:
    """Tilt the foot constants so that the median planted foot is level (corrections up to 35 degrees)."""
    out = dict(constants)
    for side in SIDES:
        name = f"{side}_foot"
        planted = _planted(raws, marks, side)
        if not planted.any() or name not in segments:
            continue
        r = _rotations(raws, segments[name])[planted] @ constants[name]
        up = normalize(np.median(np.einsum("nji,j->ni", r, _UP), axis=0))  # the vertical in foot axes
        if up[2] > np.cos(np.radians(35.0)):
            out[name] = constants[name] @ matrix_between(_UP, up)
    return out


def retarget(raw: RawMotion, calibration: Calibration | None = None) -> Array:
    """Canonical joint positions (T, 22, 3) at 30 fps; heights are still those of the source's floor.

    Args:
        raw: any motion with legs; it must carry segment rotations.
        calibration: of the source skeleton; None calibrates on this motion alone.

    Raises:
        InvalidInputError: legs that cannot be recognised.
    """
    if calibration is None:
        calibration = calibrate([raw])
    raw = raw.at_rate(FPS)
    marks, segments = raw.landmarks(), raw.segmented()
    p, g = raw.positions_w_m, raw.rotations_w
    assert g is not None
    world = {name: g[:, joint] @ calibration.segments[name] for name, joint in segments.items()}
    pelvis = world["pelvis"]
    chest = world.get("chest", pelvis)
    head = world.get("head", chest)
    q_pelvis, q_chest, q_head = (quat_from_matrix(m) for m in (pelvis, chest, head))
    frames = {
        "pelvis": pelvis,
        "spine1": matrix_from_quat(quat_slerp(q_pelvis, q_chest, 1 / 3)),
        "spine2": matrix_from_quat(quat_slerp(q_pelvis, q_chest, 2 / 3)),
        "spine3": chest,
        "neck": matrix_from_quat(quat_slerp(q_chest, q_head, 0.5)),
        "left_collar": world.get("left_collar", chest),
        "right_collar": world.get("right_collar", chest),
    }
    scale = _LEG_M / calibration.leg_m
    hips = 0.5 * (p[:, marks["left_hip"]] + p[:, marks["right_hip"]]) * scale
    out = np.empty((len(p), len(CANONICAL), 3))
    offsets = CANONICAL.offsets_m
    out[:, 0] = hips - pelvis @ (0.5 * (offsets[J["left_hip"]] + offsets[J["right_hip"]]))
    for name, joint in J.items():
        parent = CANONICAL.names[CANONICAL.parents[joint]]
        if joint == 0:
            continue
        if parent in frames:
            bone = frames[parent] @ offsets[joint]
        elif name.endswith("_foot"):
            bone = world[name] @ offsets[joint]
        else:
            bone = _limb_direction(p, marks, name, frames) * CANONICAL.bone_lengths_m[joint]
        out[:, joint] = out[:, CANONICAL.parents[joint]] + bone
    return out


def _limb_direction(p: Array, marks: dict[str, int], name: str, frames: dict[str, Array]) -> Array:
    """(T, 3) unit direction of the source's bone that ends in the canonical joint `name`."""
    start = CANONICAL.names[CANONICAL.parents[J[name]]]
    if start in marks and name in marks:
        return normalize(p[:, marks[name]] - p[:, marks[start]])
    # An arm the source does not have hangs beside the trunk.
    return normalize(-frames["spine3"][..., 2] + 0.05 * frames["spine3"][..., 0])
