"""How soon a changed command shows: the first movement of its kind after the change. Pure numpy over positions."""

from __future__ import annotations

from dataclasses import dataclass
from math import degrees, radians

import numpy as np
import numpy.typing as npt

from shared.errors import InvalidInputError
from shared.motion.heading import hips_heading
from shared.motion.skeleton import CANONICAL

Array = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

SPEED_S = 0.2
"""Speeds are chords over so long."""
SET_OFF_MPS, QUICKEN_MPS, SLOW_MPS, RUNNING_MPS = 0.3, 0.4, 0.4, 1.8
FASTER_MPS, SURE_MPS = 0.2, 0.7
AT_SPEED_MPS, SLOWED = 1.2, 0.7
"""Who goes faster than this and is told to do something on the spot has begun with it at this share of the speed."""
TURN_RAD, RAISE_M, DIP_M, LIFT_M, SQUAT_M, BACK_MPS = radians(15), 0.15, 0.04, 0.03, 0.08, 0.1
LIMB_MPS, BEYOND_MPS = 1.5, 0.3
"""A punch's or kick's speed, and by how much it is beyond what that limb did in the second before."""

_FEET = CANONICAL.indices("left_ankle", "right_ankle", "left_foot", "right_foot")
_ON_THE_SPOT = ("jump", "squat", "punch", "kick")
_LIMBS = {"punch": "wrist", "kick": "ankle", "wave": "wrist"}


@dataclass(frozen=True)
class FirstMovement:
    """`after_s`: from the change to the first frame that shows it, or None; `measures`: what that rests on."""

    after_s: float | None
    measures: dict[str, float]


def first_movement(kind: str, before_w_m: Array, after_w_m: Array, fps: float) -> FirstMovement:
    """Whether motion after a change (T, 22, 3) begins what its command asks for, seen from the motion before it.

    walk: the pelvis goes ahead at 0.3 m/s and 0.2 m/s faster than before (0.7 m/s is enough), or who went faster than
    1.2 m/s slows by 0.4 m/s; run: it goes at 1.8 m/s, or 0.4 m/s faster than before; walk_back: it goes backwards at
    0.1 m/s; stand: it slows to 0.6 of its speed or below 0.3 m/s; turn_*: the hips have turned by 15 deg to that
    side; wave_*: that wrist has risen by 0.15 m, or is above its shoulder and moves at 0.3 m/s; jump: the pelvis has
    dipped by 4 cm or both feet are 3 cm up; squat: it has dipped by 8 cm; punch_*, kick_*: that wrist moves at
    1.5 m/s against its shoulder, that ankle against the pelvis, and 0.3 m/s faster than in the second before. Who goes
    at 1.2 m/s or more begins walk_back, jump, squat, punch and kick by slowing to 0.7 of that.

    Args:
        kind: one of them.
        before_w_m: what led up to the change, its frame included; at least a second of it, which tells what is new.
        after_w_m: from the frame of the change on, that frame included.
        fps: of both.

    Raises:
        InvalidInputError: no such kind.
    """
    base, _, side = kind.partition("_")
    before, after = np.asarray(before_w_m, dtype=np.float64), np.asarray(after_w_m, dtype=np.float64)
    if kind in ("walk", "run", "stand", "walk_back"):
        shown, measures = _gait(kind, before, after, fps)
    elif base == "turn" and side in ("left", "right"):
        turned = np.unwrap(hips_heading(after))
        turned = (turned - turned[0]) * (1 if side == "left" else -1)
        shown, measures = turned >= TURN_RAD, {"turned_deg": degrees(float(turned.max()))}
    elif kind in ("jump", "squat"):
        dip = after[0, 0, 2] - after[:, 0, 2]
        lift = (after[:, _FEET, 2] - CANONICAL.rest_positions_m[_FEET, 2]).min(-1)
        shown = dip >= SQUAT_M if kind == "squat" else (dip >= DIP_M) | (lift >= LIFT_M)
        measures = {"dip_m": float(dip.max()), "lift_m": float(lift.max())}
    elif base in _LIMBS and side in ("left", "right"):
        shown, measures = _limb(base, side, before, after, fps)
    else:
        raise InvalidInputError(f"no rule for the first movement of {kind!r}", field="kind")
    if base in _ON_THE_SPOT:
        speed = _chords(before, after, fps)[1]
        measures = {**measures, "speed_before_mps": float(speed[0]), "speed_after_mps": float(speed[-1])}
        if speed[0] >= AT_SPEED_MPS:
            shown = shown | (speed <= SLOWED * speed[0])
    return FirstMovement(float(np.argmax(shown)) / fps if shown.any() else None, measures)


def _chords(before: Array, after: Array, fps: float) -> tuple[Array, Array]:
    """Horizontal velocity (T, 2) of the pelvis at every frame after the change, over SPEED_S, and its size (T,)."""
    width = max(1, round(SPEED_S * fps))
    led = np.concatenate([before[-width - 1 : -1], after])
    chord: Array = (led[width:, 0, :2] - led[:-width, 0, :2]) * (fps / width)
    return chord, np.linalg.norm(chord, axis=-1)


def _gait(kind: str, before: Array, after: Array, fps: float) -> tuple[Bools, dict[str, float]]:
    chord, speed = _chords(before, after, fps)
    heading = hips_heading(after)
    ahead = chord[:, 0] * np.cos(heading) + chord[:, 1] * np.sin(heading)
    first = float(speed[0])
    measures = {"speed_before_mps": first, "speed_after_mps": float(speed[-1])}
    if kind == "stand":
        return (speed <= 0.6 * first) | (speed < SET_OFF_MPS), measures
    if kind == "walk_back":
        slowed = (speed <= SLOWED * first) & (first >= AT_SPEED_MPS)
        return (ahead <= -BACK_MPS) | slowed, {**measures, "ahead_mps": float(ahead.min())}
    if kind == "run":
        return (ahead >= RUNNING_MPS) | (ahead >= first + QUICKEN_MPS), measures
    if first > AT_SPEED_MPS:
        return speed <= first - SLOW_MPS, measures
    return ahead >= min(max(SET_OFF_MPS, float(ahead[0]) + FASTER_MPS), SURE_MPS), measures


def _limb(base: str, side: str, before: Array, after: Array, fps: float) -> tuple[Bools, dict[str, float]]:
    joint = CANONICAL.index(f"{side}_{_LIMBS[base]}")
    root = CANONICAL.index("pelvis" if base == "kick" else f"{side}_shoulder")
    led = np.concatenate([before[-round(fps) - 1 : -1], after])
    speed = np.linalg.norm(np.diff(led[:, joint] - led[:, root], axis=0), axis=-1) * fps
    was, speed = speed[: -len(after)], speed[-len(after) :]
    if base == "wave":
        rise = after[:, joint, 2] - after[0, joint, 2]
        up = (after[:, joint, 2] > after[:, root, 2]) & (speed > SET_OFF_MPS)
        return (rise >= RAISE_M) | up, {"raised_m": float(rise.max())}
    least = max(LIMB_MPS, float(was.max(initial=0.0)) + BEYOND_MPS)
    return speed >= least, {"limb_mps": float(speed.max()), "limb_before_mps": float(was.max(initial=0.0))}
