"""Strict rules for kinds of movement that a sentence may ask for, by name and not by its words (docs/tasks.md).

`shared.tasks.obey` reads the six kinds of DESIGN 7 out of a text; here the kind is told, so that any wording of it can
be judged. Pure numpy over positions (T, 22, 3) at 30 Hz.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import degrees, radians

import numpy as np
import numpy.typing as npt

from shared.errors import InvalidInputError
from shared.motion.heading import hips_heading
from shared.motion.skeleton import CANONICAL
from shared.protocol.rates import TICK_HZ
from shared.tasks import rules
from shared.tasks.interface import Trace
from shared.tasks.obey import JUMP_M, RUN_MPS, STAND_M, STAND_SETTLE_S, TURN_RAD, WALK_M

Array = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]
Measures = dict[str, float]

WALK_MPS = 2.2
BACK_M, SIDE_M, CURVE_M, CURVE_RAD = 0.8, 0.8, 1.0, radians(30)
STEP_M = 0.15
WAVE_SWING_M, WAVE_REVERSALS = 0.12, 3
SQUAT_M, SITTING_HEAD_M, LYING_HEAD_M = 0.25, 0.35, 0.5
PUNCH_MPS, PUNCH_REACH, PUNCH_WITHIN_S = 1.5, 0.8, 0.2
KICK_LIFT_M, KICK_AWAY_M, KICK_BEHIND_M = 0.25, 0.35, 0.1
UPRIGHT_SHARE = 0.8
SIDES = ("left", "right")


@dataclass(frozen=True)
class Judgement:
    """Whether a kind was done, and the numbers it rests on (SI; the name carries the unit)."""

    done: bool
    measures: Measures


@dataclass(frozen=True)
class Travel:
    """Ways of the pelvis as the body sees them, in chords of half a second: ahead and to the left, summed with sign."""

    ahead_m: float
    left_m: float

    @classmethod
    def of(cls, p: Array) -> Travel:
        """Of positions (T, 22, 3)."""
        step = rules.HOLD_TICKS
        chord = np.diff(p[::step, 0, :2], axis=0)
        middle = np.minimum(np.arange(len(chord)) * step + step // 2, len(p) - 1)
        heading = hips_heading(p[middle]) if len(middle) else np.zeros(0)
        c, s = np.cos(heading), np.sin(heading)
        return cls(float((chord[:, 0] * c + chord[:, 1] * s).sum()), float((chord[:, 1] * c - chord[:, 0] * s).sum()))


def judge(kind: str, trace: Trace) -> Judgement:
    """Judge what was done under one sentence, by the rule of its kind; falls are the caller's.

    Raises:
        InvalidInputError: a kind that has no rule, naming those that have.
    """
    check_kind(kind)
    p = np.asarray(trace.pos_w_m, dtype=np.float64)
    if len(p) < TICK_HZ:
        return Judgement(False, {})
    if kind == "other":
        return Judgement(True, {})
    plain = _PLAIN.get(kind)
    if plain is not None:
        return plain(p)
    base, _, side = kind.partition("_")
    found = [_SIDED[base](p, each) for each in ((side,) if side else SIDES)]
    return next((one for one in found if one.done), found[0])


def check_kind(kind: str) -> None:
    """Raises InvalidInputError for a kind that has no rule."""
    if kind not in KINDS:
        raise InvalidInputError(f"no rule for the kind {kind!r}", field="kind", allowed=", ".join(KINDS))


def _walk(p: Array) -> Judgement:
    way, speed = Travel.of(p), rules.best_speed_mps(p[:, 0, :2])
    return Judgement(way.ahead_m >= WALK_M and speed <= WALK_MPS, {"ahead_m": way.ahead_m, "speed_mps": speed})


def _back(p: Array) -> Judgement:
    way = Travel.of(p)
    return Judgement(-way.ahead_m >= max(BACK_M, abs(way.left_m)), {"ahead_m": way.ahead_m, "left_m": way.left_m})


def _step_back(p: Array) -> Judgement:
    way = Travel.of(p)
    return Judgement(-way.ahead_m >= max(STEP_M, abs(way.left_m)), {"ahead_m": way.ahead_m, "left_m": way.left_m})


def _run(p: Array) -> Judgement:
    speed, way = rules.best_speed_mps(p[:, 0, :2]), Travel.of(p)
    return Judgement(speed >= RUN_MPS and way.ahead_m > 0, {"speed_mps": speed, "ahead_m": way.ahead_m})


def _jump(p: Array) -> Judgement:
    height = rules.jump_height_m(p)
    return Judgement(height >= JUMP_M, {"jump_m": height})


def _stand(p: Array) -> Judgement:
    rest = p[round(STAND_SETTLE_S * TICK_HZ) :]
    drift = rules.drift_m(rest[:, 0, :2])
    head = CANONICAL.index("head")
    low = float(rest[:, head, 2].min() / CANONICAL.rest_positions_m[head, 2]) if len(rest) else 0.0
    return Judgement(bool(len(rest)) and drift < STAND_M and low > UPRIGHT_SHARE, {"drift_m": drift, "head_share": low})


def _squat(p: Array) -> Judgement:
    """The pelvis is 25 cm lower, the head well above it, and never near the floor."""
    lowered = CANONICAL.rest_positions_m[0, 2] - p[:, 0, 2]
    above = p[:, CANONICAL.index("head"), 2] - p[:, 0, 2]
    done = bool(((lowered >= SQUAT_M) & (above >= SITTING_HEAD_M)).any()) and not lying_down(p).any()
    return Judgement(done, {"lowered_m": float(lowered.max()), "head_m": float(p[:, CANONICAL.index("head"), 2].min())})


def lying_down(pos_w_m: npt.ArrayLike) -> Bools:
    """(T,) whether the head of a body (T, 22, 3) is lower than that of anyone who squats or sits on the floor."""
    return np.asarray(pos_w_m)[:, CANONICAL.index("head"), 2] < LYING_HEAD_M


def _aside(p: Array, side: str) -> Judgement:
    way, sign = Travel.of(p), _sign(side)
    turned = rules.turned_rad(p) * sign
    stepped = way.left_m * sign >= max(SIDE_M, abs(way.ahead_m))
    curved = way.ahead_m >= CURVE_M and turned >= CURVE_RAD
    return Judgement(
        stepped or curved, {"side_m": way.left_m * sign, "ahead_m": way.ahead_m, "turned_deg": degrees(turned)}
    )


def _step_aside(p: Array, side: str) -> Judgement:
    way = Travel.of(p)
    aside = way.left_m * _sign(side)
    return Judgement(aside >= max(STEP_M, abs(way.ahead_m)), {"side_m": aside, "ahead_m": way.ahead_m})


def _turn(p: Array, side: str) -> Judgement:
    turned = rules.turned_rad(p) * _sign(side)
    return Judgement(turned >= TURN_RAD, {"turned_deg": degrees(turned)})


def _wave(p: Array, side: str) -> Judgement:
    """While the wrist is above its shoulder it turns round three times, each way at least 12 cm along one axis of the
    body."""
    seen = wrist_seen_m(p, side)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], seen[:, 2] > 0, [False]]).astype(np.int8)))
    stretches = [seen[start:stop] for start, stop in zip(edges[::2], edges[1::2], strict=True)]
    count = max((reversals(axis, WAVE_SWING_M) for stretch in stretches for axis in stretch.T), default=0)
    return Judgement(count >= WAVE_REVERSALS, {"reversals": float(count)})


def reversals(signal: Array, least: float) -> int:
    """How often a (T,) signal turns round between ways of at least `least` each, wherever it begins within one."""
    count, direction = 0, 0
    low = high = float(signal[0])
    for value in map(float, signal):
        low, high = min(low, value), max(high, value)
        turned = -1 if high - value >= least else 1 if value - low >= least else 0
        if turned and turned != direction:
            count += direction != 0
            direction = turned
            low = high = value
    return count


def _punch(p: Array, side: str) -> Judgement:
    """The wrist goes ahead at 1.5 m/s against the pelvis, faster than the other one just then, and the arm is stretched
    within 0.2 s."""
    other = SIDES[side == "left"]
    ahead = {each: ahead_mps(p, f"{each}_wrist") for each in SIDES}
    reach = arm_reach(p, side)
    width = round(PUNCH_WITHIN_S * TICK_HZ) + 1
    stretched = np.lib.stride_tricks.sliding_window_view(reach, width).max(-1) >= PUNCH_REACH
    fast = (ahead[side] >= PUNCH_MPS) & (ahead[side] > ahead[other])
    measures = {"wrist_mps": float(ahead[side].max()), "other_wrist_mps": float(ahead[other].max())}
    return Judgement(bool((fast[: len(stretched)] & stretched).any()), {**measures, "reach": float(reach.max())})


def _kick(p: Array, side: str) -> Judgement:
    """The ankle is 25 cm up and 35 cm away from the pelvis, not behind it, while the other foot is on the floor."""
    ankle, other = CANONICAL.indices(f"{side}_ankle", f"{SIDES[side == 'left']}_ankle")
    rest = CANONICAL.rest_positions_m
    away = p[:, ankle, :2] - p[:, 0, :2]
    ahead = ahead_m(p, f"{side}_ankle")
    lift = p[:, ankle, 2] - rest[ankle, 2]
    kicked = (lift >= KICK_LIFT_M) & (np.linalg.norm(away, axis=-1) >= KICK_AWAY_M) & (ahead >= -KICK_BEHIND_M)
    kicked &= p[:, other, 2] - rest[other, 2] < JUMP_M
    return Judgement(bool(kicked.any()), {"lift_m": float(lift.max()), "ahead_m": float(ahead.max())})


def ahead_mps(pos_w_m: Array, joint: str, fps: float = TICK_HZ) -> Array:
    """(T,) speed of a joint against the pelvis in the direction that the hips face, of positions (T, 22, 3)."""
    heading = hips_heading(pos_w_m)
    move = np.gradient(pos_w_m[:, CANONICAL.index(joint), :2] - pos_w_m[:, 0, :2], axis=0) * fps
    return np.asarray(move[:, 0] * np.cos(heading) + move[:, 1] * np.sin(heading))


def ahead_m(pos_w_m: Array, joint: str) -> Array:
    """(T,) how far a joint is from the pelvis in the direction that the hips face."""
    heading = hips_heading(pos_w_m)
    away = pos_w_m[:, CANONICAL.index(joint), :2] - pos_w_m[:, 0, :2]
    return np.asarray(away[:, 0] * np.cos(heading) + away[:, 1] * np.sin(heading))


def wrist_seen_m(pos_w_m: Array, side: str) -> Array:
    """(T, 3) a wrist seen from its shoulder: ahead, to the left and up, as the hips face."""
    arm = pos_w_m[:, CANONICAL.index(f"{side}_wrist")] - pos_w_m[:, CANONICAL.index(f"{side}_shoulder")]
    heading = hips_heading(pos_w_m)
    c, s = np.cos(heading), np.sin(heading)
    return np.stack([arm[:, 0] * c + arm[:, 1] * s, arm[:, 1] * c - arm[:, 0] * s, arm[:, 2]], axis=-1)


def arm_reach(pos_w_m: Array, side: str) -> Array:
    """(T,) how far a wrist is from its shoulder, as a share of the arm's length."""
    shoulder, elbow, wrist = CANONICAL.indices(f"{side}_shoulder", f"{side}_elbow", f"{side}_wrist")
    rest = CANONICAL.rest_positions_m[[shoulder, elbow, wrist]]
    arm_m = np.linalg.norm(np.diff(rest, axis=0), axis=-1).sum()
    return np.asarray(np.linalg.norm(pos_w_m[:, wrist] - pos_w_m[:, shoulder], axis=-1) / arm_m)


def _sign(side: str) -> int:
    return 1 if side == "left" else -1


_PLAIN: dict[str, Callable[[Array], Judgement]] = {
    "walk": _walk, "walk_back": _back, "step_back": _step_back, "run": _run, "jump": _jump, "stand": _stand,
    "squat": _squat,
}  # fmt: skip
_SIDED: dict[str, Callable[[Array, str], Judgement]] = {
    "walk": _aside, "step": _step_aside, "turn": _turn, "wave": _wave, "punch": _punch, "kick": _kick
}  # fmt: skip
LOW_KINDS = ("squat",)
"""Done by going down: only who lies, or what the tracker calls a fall, has fallen."""
KINDS = (
    *_PLAIN,
    *(f"{base}_{side}" for base in _SIDED for side in SIDES),
    "step", "turn", "wave", "punch", "kick", "other",
)  # fmt: skip
"""All that have a rule; those without a side take either."""
