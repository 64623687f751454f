"""What is planned for several times: of some motion most plans show half a deed, and the best one is performed.

The network foresees a mean over phases, and so of a punch from a stand a small one, late or never: of runs of five
seconds without physics one of twenty showed a punch. Told where the fist should be and when, it knows the phase. Of
several plans one is chosen by what the motion shows, as in rejection sampling (tables in docs/experiments_planner.md).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import cos, sin

import numpy as np
import numpy.typing as npt

from shared.motion.features import RootState
from shared.motion.heading import hips_heading
from shared.motion.skeleton import CANONICAL
from shared.protocol.messages import PLANNER_FPS, HeadingTarget, JointTarget, Plan, PlanRequest

Array = npt.NDArray[np.float64]
SIDES = ("left", "right")

TOP_MPS, FASTER_MPS = 5.0, 0.5
"""Faster punches are no better; a fist is this much faster than the other."""
STRETCHED, STRETCHED_FRAMES = 0.85, 4
LIFT_M, REACH_M, HIGH_M = 0.45, 0.5, 0.65
"""A kick is better the higher and the farther up to here; higher than the last it throws the body."""
CALM_MPS = 0.55
"""Of kicks with a pelvis faster than 0.67 m/s one in twelve ended in a fall, slower than 0.57 one in a hundred."""
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
        tries: plans that are made. worth: of a motion (T, 22, 3) at PLANNER_FPS and a side, `left`, `right` or empty.
        lands: where a limb is sent; None where words are enough.
    """

    tries: int
    worth: Callable[[Array, str], float]
    lands: Landing | None = None


def deed_of(meaning: str | None, request: PlanRequest) -> tuple[Deed, str] | None:
    """The deed that a meaning (`ACTION` or `ACTION:SIDE`) is, and its side; None for all else, and for requests that
    say themselves where to be."""
    if meaning is None or request.targets or request.heading is not None or len(request.keyframe_ticks):
        return None
    if request.desired_velocity_w_mps is not None or request.guidance == 0.0:
        return None
    action, _, side = meaning.partition(":")
    deed = DEEDS.get(action)
    return None if deed is None else (deed, side)


def tries_of(request: PlanRequest, state: RootState, deed: Deed, side: str) -> list[tuple[PlanRequest, str]]:
    """Requests for a deed, with the side that each is for; the first has the seed of the one that was asked for."""
    own = side or (SIDES[request.seed % 2] if deed.lands else "")
    told = request if deed.lands is None else _sent(request, state, deed.lands, own)
    words = np.random.SeedSequence(request.seed).generate_state(deed.tries, np.uint64)
    seeds = [request.seed, *(int(word >> np.uint64(1)) for word in words[1:])]
    return [(told.model_copy(update={"seed": seed}), own) for seed in seeds]


def as_asked(request: PlanRequest, told: PlanRequest, plan: Plan) -> Plan:
    """The plan of one of the tries as that of the request, with the text that it was made for."""
    other = told.text if told.text != request.text else plan.understood
    return plan.model_copy(update={"seed": request.seed, "understood": other})


def worth_of(deed: Deed, side: str, request: PlanRequest, plan_w_m: npt.NDArray[np.floating]) -> float:
    """How well a plan does it, the more the better."""
    before = request.prefix_positions_w_m[-PREFIX_FRAMES:]
    return deed.worth(np.concatenate([before, plan_w_m]).astype(np.float64), side)


def punching(motion_w_m: Array, side: str) -> float:
    """Speed of a fist ahead against the pelvis, m/s, less what the other hand or a bent arm takes from it."""
    return max(_punching(motion_w_m, each) for each in ([side] if side else SIDES))


def kicking(motion_w_m: Array, side: str) -> float:
    """How high and far ahead of the pelvis an ankle gets while the other foot stands, m."""
    return max(_kicking(motion_w_m, each) for each in ([side] if side else SIDES))


def _punching(p: Array, side: str) -> float:
    shoulder, elbow, wrist = CANONICAL.indices(*(f"{side}_{name}" for name in ("shoulder", "elbow", "wrist")))
    own, other = (_ahead_mps(p, CANONICAL.index(f"{each}_wrist")) for each in (side, _other(side)))
    arm = np.linalg.norm(np.diff(CANONICAL.rest_positions_m[[shoulder, elbow, wrist]], axis=0), axis=-1).sum()
    reach = np.linalg.norm(p[:, wrist] - p[:, shoulder], axis=-1) / arm
    padded = np.concatenate([reach, np.repeat(reach[-1:], STRETCHED_FRAMES)])
    reach = np.lib.stride_tricks.sliding_window_view(padded, STRETCHED_FRAMES + 1).max(-1)
    lost = np.maximum(0.0, other - own + FASTER_MPS) + 10.0 * np.maximum(0.0, STRETCHED - reach)
    return float((np.minimum(own, TOP_MPS) - lost).max())


def _kicking(p: Array, side: str) -> float:
    own, other = CANONICAL.indices(f"{side}_ankle", f"{_other(side)}_ankle")
    rest = CANONICAL.rest_positions_m[:, 2]
    heading = hips_heading(p)
    away = p[:, own, :2] - p[:, 0, :2]
    ahead = away[:, 0] * np.cos(heading) + away[:, 1] * np.sin(heading)
    lift, hop = p[:, own, 2] - rest[own], p[:, other, 2] - rest[other]
    good = np.minimum(lift, LIFT_M) + np.minimum(ahead, REACH_M)
    hurry = np.linalg.norm(np.diff(p[:, 0, :2], axis=0), axis=-1).max() * PLANNER_FPS - CALM_MPS
    return float((good - 2.0 * np.maximum(0.0, lift - HIGH_M) - 4.0 * np.maximum(0.0, hop)).max() - max(0.0, hurry))


def _ahead_mps(p: Array, joint: int) -> Array:
    heading = hips_heading(p)
    move = np.gradient(p[:, joint, :2] - p[:, 0, :2], axis=0) * PLANNER_FPS
    return np.asarray(move[:, 0] * np.cos(heading) + move[:, 1] * np.sin(heading))


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


PUNCH = Deed(12, punching, Landing("wrist", ahead_m=0.8, up_m=1.35, step_m=0.2, ticks=18))
KICK = Deed(12, kicking, Landing("foot", 0.8, 0.5, 0.2, 24, text="a person kicks with the {side} foot"))
"""Fists land early: told to land three ticks later, few are fast enough once a body with mass performs them. Kicks are
told by the words that those which aim at something were trained with."""
DEEDS: Mapping[str, Deed] = {
    **dict.fromkeys(("punch", "punch_at", "punch_step", "box"), PUNCH),
    **dict.fromkeys(("kick", "kick_at", "kick_any", "kick_front"), KICK),
}
"""By action of shared/data."""
