"""Success rules on recorded motion: pure numpy over (T, ...) arrays at 30 Hz.

`paper` and `code` are the rules of CLoSD's paper and release (REFERENCE 3); `strict` is the headline of DESIGN 7: the
goal is met and held, and the character has not fallen until one second after.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from shared.motion.heading import hips_heading
from shared.motion.skeleton import CANONICAL
from shared.protocol.messages import TICK_HZ
from shared.tasks.interface import Trace

Array = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

REACH_RADIUS_M = 0.3
HOLD_TICKS = TICK_HZ // 2
SAFE_TICKS = TICK_HZ
DOWN_TICKS = 9
"""0.3 s, as the tracker's own rule (DESIGN 2)."""
TRUNK_ON_FLOOR_M = 0.17
LEANING_SHARE = 0.8

_J = {name: CANONICAL.index(name) for name in CANONICAL.names}
_HEAD = _J["head"]
_STANDING_HEAD_M = float(CANONICAL.rest_positions_m[_HEAD, 2])
_TRUNK = CANONICAL.indices("pelvis", "spine1", "spine2", "spine3", "neck", "head")


@dataclass(frozen=True)
class ReachOutcome:
    """`met_tick`: index of the first strict contact with the goal, or None."""

    strict: bool
    paper: bool
    code: bool
    met_tick: int | None


def first_held(inside: Bools, hold_ticks: int = HOLD_TICKS) -> int | None:
    """First index i with inside[i] and inside[i + hold_ticks], or None."""
    if len(inside) <= hold_ticks:
        return None
    both = inside[:-hold_ticks] & inside[hold_ticks:]
    return int(np.argmax(both)) if both.any() else None


def reach(
    pelvis_xy_m: Array, fallen: Bools, goal_xy_m: npt.ArrayLike, radius_m: float = REACH_RADIUS_M
) -> ReachOutcome:
    """Reach: (T, 2) pelvis over the floor, (T,) fallen, goal (2,).

    code: the pelvis was within the radius at some tick. paper: and it had not fallen before. strict: within it, still
    within it half a second later, and no fall until a second after that.
    """
    inside = np.linalg.norm(np.asarray(pelvis_xy_m) - np.asarray(goal_xy_m), axis=-1) <= radius_m
    if not inside.any():
        return ReachOutcome(False, False, False, None)
    touched = int(np.argmax(inside))
    met = first_held(inside)
    strict = met is not None and not fallen[: met + HOLD_TICKS + SAFE_TICKS + 1].any()
    return ReachOutcome(strict, not bool(fallen[: touched + 1].any()), True, met)


def lying(pos_w_m: npt.ArrayLike) -> Bools:
    """(T,) whether a body (T, 22, 3) has been down for 0.3 s: head below half its standing height, or trunk on floor.

    Unlike the tracker's `fallen` this does not ask what the reference does: a planner that continues what it sees goes
    on to plan for a body that has toppled, and then the reference lies too. For tasks that nobody does lying down.
    """
    p = np.asarray(pos_w_m, dtype=np.float64)
    down = (p[:, _HEAD, 2] < 0.5 * _STANDING_HEAD_M) | (p[:, _TRUNK, 2] < TRUNK_ON_FLOOR_M).any(axis=1)
    rows = np.arange(len(p))
    up_last = np.maximum.accumulate(np.where(down, -1, rows))
    return np.asarray(rows - up_last >= DOWN_TICKS)


def with_falls(trace: Trace) -> Trace:
    """The same trace, in which a body on the floor has fallen whatever its plan says (see `lying`)."""
    return replace(trace, fallen=trace.fallen | lying(trace.pos_w_m))


def leaning(pos_w_m: npt.ArrayLike) -> bool:
    """Whether a body (22, 3) is on its way down or bent low: its head below 0.8 of its standing height."""
    return float(np.asarray(pos_w_m)[_HEAD, 2]) < LEANING_SHARE * _STANDING_HEAD_M


def drift_m(pelvis_xy_m: Array) -> float:
    """Largest distance of the pelvis from where the stretch began."""
    xy = np.asarray(pelvis_xy_m)
    return float(np.linalg.norm(xy - xy[0], axis=-1).max()) if len(xy) else 0.0


def travelled_m(pelvis_xy_m: Array) -> float:
    """Path length in chords of half a second, which leaves the sway of a step out."""
    xy = np.asarray(pelvis_xy_m)[::HOLD_TICKS]
    return float(np.linalg.norm(np.diff(xy, axis=0), axis=-1).sum())


def best_speed_mps(pelvis_xy_m: Array, window_s: float = 1.0) -> float:
    """Highest mean speed, as the chord over `window_s`."""
    n = round(window_s * TICK_HZ)
    xy = np.asarray(pelvis_xy_m)
    if len(xy) <= n:
        return 0.0
    return float(np.linalg.norm(xy[n:] - xy[:-n], axis=-1).max() / window_s)


def turned_rad(pos_w_m: Array) -> float:
    """Largest turn from the first heading, signed (left positive), unwrapped."""
    heading = np.unwrap(hips_heading(pos_w_m))
    turn = heading - heading[0]
    return float(turn[np.argmax(np.abs(turn))])


def reversals(signal: Array, least: float) -> int:
    """How often a (T,) signal turns round, counting only swings larger than `least`."""
    count, direction, extreme = 0, 0, float(signal[0]) if len(signal) else 0.0
    for value in np.asarray(signal, dtype=np.float64):
        if direction == 0:
            if abs(value - extreme) >= least:
                direction, extreme = (1 if value > extreme else -1), float(value)
        elif direction * (value - extreme) > 0:
            extreme = float(value)
        elif abs(value - extreme) >= least:
            count, direction, extreme = count + 1, -direction, float(value)
    return count


def wave_reversals(pos_w_m: Array, least_m: float = 0.04) -> int:
    """Most reversals that a wrist makes, seen from its shoulder, during one stretch above that shoulder.

    The larger of the counts along the body's left axis, its forward axis and the vertical, over both arms.
    """
    p = np.asarray(pos_w_m, dtype=np.float64)
    heading = hips_heading(p)
    left = np.stack([-np.sin(heading), np.cos(heading), np.zeros_like(heading)], axis=-1)
    forward = np.stack([np.cos(heading), np.sin(heading), np.zeros_like(heading)], axis=-1)
    best = 0
    for side in ("left", "right"):
        arm = p[:, _J[f"{side}_wrist"]] - p[:, _J[f"{side}_shoulder"]]
        above = arm[:, 2] > 0
        edges = np.flatnonzero(np.diff(np.concatenate([[False], above, [False]]).astype(np.int8)))
        for start, stop in zip(edges[::2], edges[1::2], strict=True):
            stretch = arm[start:stop]
            axes = (np.sum(stretch * left[start:stop], -1), np.sum(stretch * forward[start:stop], -1), stretch[:, 2])
            best = max(best, *(reversals(axis, least_m) for axis in axes))
    return best


def jump_height_m(pos_w_m: Array) -> float:
    """Highest that both feet were off the floor at once (the lowest of ankles and toes above its standing height)."""
    p = np.asarray(pos_w_m, dtype=np.float64)
    feet = CANONICAL.indices("left_ankle", "right_ankle", "left_foot", "right_foot")
    lift = p[:, feet, 2] - CANONICAL.rest_positions_m[feet, 2]
    return float(lift.min(axis=1).max()) if len(lift) else 0.0
