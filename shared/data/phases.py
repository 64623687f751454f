"""Cutting takes that hold several things into pieces of one thing each, by what the kinematics show."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter1d, maximum_filter1d, median_filter, minimum_filter1d

from shared.data.label import Label, airborne, chunks
from shared.data.props import Seat
from shared.motion.body import SIDES, Array, Bools, J, forward_of, heading_rad, left_axis, runs, sole_points, velocity
from shared.motion.heading import faced_by, heading_of
from shared.motion.rotations import normalize, wrap_angle
from shared.protocol.rates import CORPUS_FPS as FPS

_SHORTEST = 60
_SEAT_DROP_M = 0.14
"""A pelvis this far below where it stands, and still, sits."""
_SETTLED_FRAMES = 45
_STOOL_M = (0.36, 0.36, 0.05)
_WAVE_M = 0.1


@dataclass(frozen=True)
class Phase:
    """Frames [start, stop) of a take, what they show, and the seat in them."""

    start: int
    stop: int
    label: Label
    seat: Seat | None = None


def phases_of(action: str, p: Array) -> list[Phase] | None:
    """The phases of a take of several things, by its action; None for a take of one thing.

    Args:
        action: of the take as a whole: `sit_any`, `exercise`, `reach_up` or `gesture_traffic`.
        p: (T, 22, 3) grounded poses at 30 fps.
    """
    cutters = {"sit_any": _sits, "exercise": _exercises, "reach_up": _reaches, "gesture_traffic": _signals}
    return cutters[action](p) if action in cutters else None


def seated_runs(p: Array) -> list[tuple[int, int]]:
    """Half-open ranges of at least a second in which the body sits still on a seat, in a take that also stands."""
    z = p[:, 0, 2]
    speed = np.linalg.norm(velocity(gaussian_filter1d(p[:, 0], 2.0, axis=0, mode="nearest"), FPS), axis=-1)
    out: list[tuple[int, int]] = []
    for a, b in runs((z < np.percentile(z, 95) - _SEAT_DROP_M) & (speed < 0.18)):
        if out and a - out[-1][1] < 20:
            out[-1] = (out[-1][0], b)
        else:
            out.append((a, b))
    return [(a, b) for a, b in out if b - a >= FPS]


def _sits(p: Array) -> list[Phase]:
    """Down, sitting still, up: the seat is under the pelvis of whoever sits still."""
    sat = seated_runs(p)
    if not sat:
        return [Phase(a, b, Label("sit", "sit_down")) for a, b in chunks(0, len(p), int(8 * FPS), _SHORTEST)]
    out = []
    last = 0
    for k, (a, b) in enumerate(sat):
        seat = Seat.under(p[a:b], _STOOL_M)
        ends = b >= len(p) - 5
        down = min(a + _SETTLED_FRAMES, (a + b) // 2)
        up = len(p) if ends else max(b - _SETTLED_FRAMES, (a + b) // 2)
        if up - down < _SHORTEST and not ends:
            down = up = (a + b) // 2
        elif up - down < _SHORTEST:
            down = up
        out.append(Phase(last, down, Label("sit", "sit_down"), seat))
        if up > down:
            out.append(Phase(down, up, Label("sit", "seated"), seat))
        if not ends:
            last = (b + sat[k + 1][0]) // 2 if k + 1 < len(sat) else len(p)
            out.append(Phase(up, last, Label("rise", "rise"), seat))
    return out


def _mark(mask: Bools, seconds: float) -> Bools:
    """Frames within `seconds` of one at which the mask holds."""
    return np.asarray(maximum_filter1d(mask.astype(np.uint8), 2 * int(seconds * FPS) + 1).astype(bool))


def _swing(x: Array, seconds: float = 1.0) -> Array:
    """Range of x (T,) within a window of `seconds`."""
    n = int(seconds * FPS) | 1
    return np.asarray(maximum_filter1d(x, n) - minimum_filter1d(x, n))


def twist_rad(p: Array) -> Array:
    """(T,) how far the shoulders are turned against the hips, positive to the left."""
    across = p[:, J["left_shoulder"]] - p[:, J["right_shoulder"]]
    return wrap_angle(heading_of(faced_by(across)) - heading_rad(p))


def _exercises(p: Array) -> list[Phase]:
    """Squats, bends to the foot, elbows to knees, jumping jacks, jogging on the spot, side twists, arm exercises."""
    up = normalize(p[:, J["neck"]] - p[:, J["pelvis"]])
    knees = np.max([p[:, J[f"{side}_knee"], 2] for side in SIDES], axis=0)
    stance = np.linalg.norm(p[:, J["left_ankle"], :2] - p[:, J["right_ankle"], :2], axis=-1)
    heels = np.max([sole_points(p, side)[:, 0, 2] for side in SIDES], axis=0)
    kinds = (
        ("exercise", "arm_swing", np.ones(len(p), dtype=bool)),
        ("exercise", "side_twist", _mark(np.abs(twist_rad(p)) > 0.3, 0.7)),
        ("exercise", "jog_in_place", _mark((heels > 0.07) & (stance < 0.45) & (_swing(p[:, 0, 2]) > 0.035), 0.5)),
        ("exercise", "jumping_jack", (_swing(p[:, 0, 2]) > 0.08) & (_swing(stance) > 0.15)),
        ("gesture", "elbow_knee", _mark(knees > 0.75, 0.5)),
        ("exercise", "bend_sideways", _mark(up[:, 2] < np.cos(np.radians(38)), 0.6)),
        ("squat", "squat", _mark(p[:, 0, 2] < 0.72, 0.6)),
    )
    kind = np.zeros(len(p), dtype=np.int64)
    for k, (_, _, mask) in enumerate(kinds):
        kind[mask] = k
    kind = median_filter(kind, 31, mode="nearest")
    return [
        Phase(start, stop, Label(*kinds[k][:2]))
        for a, b, k in _merged(kind)
        for start, stop in chunks(a, b, int(8 * FPS), _SHORTEST)
    ]


def _merged(kind: npt.NDArray[np.int64]) -> list[tuple[int, int, int]]:
    """(start, stop, kind) of runs of equal kind, those under two seconds joined to the shorter neighbour."""
    cuts = [0, *(np.flatnonzero(np.diff(kind)) + 1).tolist(), len(kind)]
    out = [(a, b, int(kind[a])) for a, b in zip(cuts[:-1], cuts[1:], strict=True)]
    while len(out) > 1:
        k = min(range(len(out)), key=lambda i: out[i][1] - out[i][0])
        if out[k][1] - out[k][0] >= _SHORTEST:
            break
        left = k > 0 and (k + 1 == len(out) or out[k - 1][1] - out[k - 1][0] <= out[k + 1][1] - out[k + 1][0])
        if left:
            out[k - 1 : k + 1] = [(out[k - 1][0], out[k][1], out[k - 1][2])]
        else:
            out[k : k + 2] = [(out[k][0], out[k + 1][1], out[k + 1][2])]
    return out


def _reaches(p: Array) -> list[Phase]:
    """Pieces of about four seconds: jumps up to grab, reaching on tiptoe, reaching up."""
    toes = np.min([sole_points(p, side)[:, 0, 2] for side in SIDES], axis=0) > 0.05
    out = []
    for a, b in chunks(0, len(p), int(4 * FPS), _SHORTEST):
        if airborne(p[a:b]).any():
            label = Label("jump", "jump_reach")
        else:
            label = Label("gesture", "reach_tiptoe" if toes[a:b].mean() > 0.3 else "reach_up")
        out.append(Phase(a, b, label))
    return out


def _signals(p: Array) -> list[Phase]:
    """Pieces of about five seconds: waving where a raised hand goes to and fro, else directing traffic."""
    out = []
    for a, b in chunks(0, len(p), int(5 * FPS), _SHORTEST):
        waving = [side for side in SIDES if waves(p[a:b], side)]
        label = Label("gesture", "gesture_traffic")
        if waving:
            label = Label("wave", "wave" if len(waving) == 1 else "wave_both", waving[0])
        out.append(Phase(a, b, label))
    return out


def waves(p: Array, side: str) -> bool:
    """Whether a hand, above its shoulder most of the time, goes to and fro across the body three times or more."""
    rel = p[:, J[f"{side}_wrist"]] - p[:, J[f"{side}_shoulder"]]
    high = rel[:, 2] > 0.0
    if high.mean() < 0.5:
        return False
    across = np.sum(rel * left_axis(p), axis=-1)
    ahead = np.sum(rel * forward_of(p), axis=-1)
    return max(_reversals(across[high]), _reversals(ahead[high])) >= 3


def _reversals(x: Array) -> int:
    """How often x turns back by at least _WAVE_M."""
    count, turn, way = 0, float(x[0]) if len(x) else 0.0, 0
    for value in x.tolist():
        if (way >= 0 and value > turn) or (way <= 0 and value < turn):
            way = way or (1 if value > turn else -1)
            turn = value
        elif abs(value - turn) >= _WAVE_M:
            count, way, turn = count + 1, -way, value
    return count
