"""What is planned for several times: of some motion most plans show half a deed, and the best one is performed.

The network foresees a mean over phases, and so of a punch from a stand a small one, late or never: of runs of five
seconds without physics one of twenty showed a punch. Told where the fist should be and when, it knows the phase. Waves
swing in some plans and hardly in others. Of several plans one is chosen by what the motion shows, as in rejection
sampling (tables in docs/experiments_planner.md).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import cos, inf, sin

import numpy as np
import numpy.typing as npt

from planner_service.dip.effort import words_alone
from shared.motion.features import RootState
from shared.motion.skeleton import CANONICAL
from shared.protocol.messages import PLANNER_FPS, HeadingTarget, JointTarget, PlanRequest
from shared.tasks.kinds import SIDES, ahead_m, ahead_mps, arm_reach, wrist_seen_m

Array = npt.NDArray[np.float64]

TOP_MPS, FASTER_MPS = 5.0, 0.5
"""Faster punches are no better; a fist is this much faster than the other."""
STRETCHED, STRETCHED_FRAMES = 0.85, 4
LIFT_M, REACH_M, HIGH_M = 0.45, 0.5, 0.65
"""A kick is better the higher and the farther up to here; higher than the last it throws the body."""
CALM_MPS = 0.55
"""Of kicks with a pelvis faster than 0.67 m/s one in twelve ended in a fall, slower than 0.57 one in a hundred."""
MOST_SWING_M = 0.2
"""A hand that swings farther waves no better."""
PREFIX_FRAMES = 3
"""So many frames of what was done count with a plan."""


@dataclass(frozen=True)
class Landing:
    """Where the end of a limb is sent, and when.

    Attributes:
        joint: without its side. ahead_m, up_m: from where the pelvis is on the floor. step_m: the pelvis goes so far
            ahead. ticks: from the start of the plan.
        text: planned for in place of the one asked for, `{side}` filled in.
    """

    joint: str
    ahead_m: float
    up_m: float
    step_m: float
    ticks: int
    text: str | None = None


@dataclass(frozen=True)
class Deed:
    """How a meaning is planned for.

    Attributes:
        worth: of a motion (T, 22, 3) at PLANNER_FPS, done with a side, `left` or `right`, or with either ("").
        lands: where the limb of that side is sent; None where the words say enough.
        tries: how often it is planned for. kept: so many of them are sampled to the end, the most promising.
        shown: of a prefix of this worth and more, in which it is done already, only `kept` are planned.
    """

    worth: Callable[[Array, str], float]
    lands: Landing | None = None
    tries: int = 12
    kept: int = 4
    shown: float = inf


def deed_of(meaning: str | None, request: PlanRequest) -> tuple[Deed, str] | None:
    """The deed that a meaning (`ACTION` or `ACTION:SIDE`) is, and its side, drawn by the seed where it has none; None
    for all else, and for requests that say themselves where to be."""
    if meaning is None or not words_alone(request):
        return None
    action, _, side = meaning.partition(":")
    deed = DEEDS.get(action)
    if deed is None:
        return None
    return deed, side or ("" if deed.lands is None else SIDES[request.seed % 2])


def tries_of(request: PlanRequest, state: RootState, deed: Deed, side: str) -> list[PlanRequest]:
    """Requests for a deed; the first has the seed of the one that was asked for."""
    told = request if deed.lands is None else _sent(request, state, deed.lands, side)
    goes_on = deed.worth(request.prefix_positions_w_m.astype(np.float64), side) >= deed.shown
    words = np.random.SeedSequence(request.seed).generate_state(deed.kept if goes_on else deed.tries, np.uint64)
    seeds = [request.seed, *(int(word >> np.uint64(1)) for word in words[1:])]
    return [told.model_copy(update={"seed": seed}) for seed in seeds]


def ranked(request: PlanRequest, deed: Deed, side: str, motions_w_m: Sequence[Array]) -> list[int]:
    """The plans of `tries_of`, best first, by what motion (N, 22, 3) each is, or is foreseen to be; what comes
    after the request's horizon counts for nothing."""
    before = request.prefix_positions_w_m[-PREFIX_FRAMES:].astype(np.float64)
    shown = [motion[: request.horizon_frames] for motion in motions_w_m]
    return [int(i) for i in np.argsort([-deed.worth(np.concatenate([before, motion]), side) for motion in shown])]


def punching(motion_w_m: Array, side: str) -> float:
    """Speed of a fist ahead against the pelvis, m/s, less what the other hand or a bent arm takes from it."""
    own, other = (ahead_mps(motion_w_m, f"{each}_wrist", PLANNER_FPS) for each in (side, _other(side)))
    reach = arm_reach(motion_w_m, side)
    padded = np.concatenate([reach, np.repeat(reach[-1:], STRETCHED_FRAMES)])
    reach = np.lib.stride_tricks.sliding_window_view(padded, STRETCHED_FRAMES + 1).max(-1)
    lost = np.maximum(0.0, other - own + FASTER_MPS) + 10.0 * np.maximum(0.0, STRETCHED - reach)
    return float((np.minimum(own, TOP_MPS) - lost).max())


def kicking(motion_w_m: Array, side: str) -> float:
    """How high and far ahead of the pelvis an ankle gets while the other foot stands and the pelvis is calm, m."""
    own, other = CANONICAL.indices(f"{side}_ankle", f"{_other(side)}_ankle")
    lift, hop = (motion_w_m[:, joint, 2] - CANONICAL.rest_positions_m[joint, 2] for joint in (own, other))
    good = np.minimum(lift, LIFT_M) + np.minimum(ahead_m(motion_w_m, f"{side}_ankle"), REACH_M)
    best = (good - 2.0 * np.maximum(0.0, lift - HIGH_M) - 4.0 * np.maximum(0.0, hop)).max()
    pelvis_mps = np.linalg.norm(np.diff(motion_w_m[:, 0, :2], axis=0), axis=-1).max() * PLANNER_FPS
    return float(best - max(0.0, pelvis_mps - CALM_MPS))


def waving(motion_w_m: Array, side: str) -> float:
    """How far a wrist swings to and fro while it is above its shoulder, m, and for what share of the motion it is."""
    return max(_swing(motion_w_m, each) for each in ((side,) if side else SIDES))


def _turns(signal: Array) -> float:
    """The ways of a signal (T,) between its turns, each of MOST_SWING_M at most, in all."""
    edges = np.flatnonzero(np.diff(np.sign(np.diff(signal)))) + 1
    ways = np.abs(np.diff(signal[np.concatenate([[0], edges, [len(signal) - 1]]).astype(int)]))
    return float(np.minimum(ways, MOST_SWING_M).sum())


def _swing(motion_w_m: Array, side: str) -> float:
    seen = wrist_seen_m(motion_w_m, side)
    up = seen[:, 2] > 0
    if up.sum() < 2:
        return float(seen[:, 2].max())
    return max(_turns(axis) for axis in seen[up].T) + float(up.mean())


def _other(side: str) -> str:
    return SIDES[side == "left"]


def _sent(request: PlanRequest, state: RootState, lands: Landing, side: str) -> PlanRequest:
    """The request with places straight ahead for the limb and for the body behind it, and the heading it has."""
    heading, tick = float(state.heading_rad), request.start_tick + lands.ticks
    x, y = (float(v) for v in request.prefix_positions_w_m[-1, 0, :2])
    ahead = cos(heading), sin(heading)

    def place(joint: str, far_m: float, up_m: float) -> JointTarget:
        where = (x + far_m * ahead[0], y + far_m * ahead[1], up_m)
        return JointTarget(joint=joint, position_w_m=where, arrival_tick=tick)

    limb, body = place(f"{side}_{lands.joint}", lands.ahead_m, lands.up_m), place("traj", lands.step_m, 0.0)
    facing = HeadingTarget(heading_rad=heading, arrival_tick=tick)
    text = request.text if lands.text is None else lands.text.format(side=side)
    return request.model_copy(update={"targets": [limb, body], "heading": facing, "text": text})


PUNCH = Deed(punching, Landing("wrist", ahead_m=0.8, up_m=1.35, step_m=0.2, ticks=18))
KICK = Deed(
    kicking, Landing("foot", ahead_m=0.8, up_m=0.5, step_m=0.2, ticks=24, text="a person kicks with the {side} foot")
)
"""Fists land early: told to land three ticks later, few are fast enough once a body with mass performs them. Kicks are
told by the words that those which aim at something were trained with."""
WAVE = Deed(waving, tries=6, kept=2, shown=1.15)
DEEDS: dict[str, Deed] = {
    **dict.fromkeys(("wave", "wave_both"), WAVE),
    **dict.fromkeys(("punch", "punch_at", "punch_step", "box"), PUNCH),
    **dict.fromkeys(("kick", "kick_at", "kick_any", "kick_front"), KICK),
}
"""By action of shared/data."""
