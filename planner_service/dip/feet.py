"""Feet of a plan, held where the plan itself says that they stand, and clear of the floor on their way; and hands.

Rebuilding a pose with exact bone lengths starts at the pelvis, so small errors of the legs end up in the feet. Here the
ankles are put back to where the network wanted them, without the creeping of a heel in contact, by two-bone IK; and the
toes are kept where they stand, about which a heel that has left the floor turns. The wrists that were asked for are put
back too: a shortened arm is a bent one.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from shared.motion.clip import MotionClip
from shared.motion.ik import clip_from_positions
from shared.motion.limbs import solve_arm, solve_leg
from shared.motion.skeleton import CANONICAL

Array = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

CONTACT = 0.5
"""A predicted contact above this holds the foot."""
MOST_HELD_M = 0.08
"""A held ankle is at most this far from where the network put it; held toes, from where that leaves them."""
TOES_SLOW_MPS = 0.5
"""Toes that are to go faster do not stand, whatever the predicted contact."""
WALKS_MPS, RUNS_MPS = 0.4, 2.0
"""A pelvis at least so fast in the mean, and never faster, walks."""
RELEASE = 0.6
"""Share of that distance left one frame after the foot has let go."""
TOES_FRAMES, TOES_TIMES = 2.0, 3
"""Toes are put where they should be for about so many frames; as the foot turns with the leg, in so many steps."""
CLEAR_M, SWING_MPS = 0.025, (0.5, 1.0)
"""A foot that swings while the other stands is so high above the floor, less so between these speeds: what the network
makes of a swing is the mean of many, and drags. (People's toes clear the ground by 1.3 cm: Winter 1992.)"""
SLACK = 0.99
"""Share left a frame while the foot is held, so that a long stand does not end in a leap."""


def held_offsets(feet_xy_m: Array, contact: Bools) -> Array:
    """(T, 2) what to add to a foot's path (T, 2) so that it stays put while in contact (T,).

    Row 0 is the last frame of the prefix and is never moved.
    """
    offset = np.zeros_like(feet_xy_m)
    for t in range(1, len(feet_xy_m)):
        if contact[t] and contact[t - 1]:
            kept = SLACK * offset[t - 1] + feet_xy_m[t - 1] - feet_xy_m[t]
            offset[t] = kept * min(1.0, MOST_HELD_M / max(float(np.linalg.norm(kept)), 1e-9))
        else:
            offset[t] = RELEASE * offset[t - 1]
    return offset


def swiftness(foot_xy_m: Array, fps: float) -> Array:
    """(T,) from 0 to 1: how surely a foot, of whose points (T, P, 2) the fastest counts, is on its way."""
    mps = np.linalg.norm(np.gradient(foot_xy_m, axis=0), axis=-1).max(-1) * fps
    slow, fast = SWING_MPS
    return np.clip((mps - slow) / (fast - slow), 0.0, 1.0)


def walks(positions_w_m: Array, fps: float) -> bool:
    """Whether the body (T, 22, 3) walks. Who runs or kicks is left alone: bodies fell where toes were kept or feet were
    lifted then, and as they jumped."""
    mps = np.linalg.norm(np.diff(positions_w_m[:, 0, :2], axis=0), axis=-1) * fps
    return bool(mps.mean() >= WALKS_MPS and mps.max() <= RUNS_MPS)


def with_planted_feet(
    wanted_w_m: Array,
    contacts: Array,
    fps: float,
    hands: Collection[str] = (),
    toes: Mapping[str, Sequence[int]] = MappingProxyType({}),
    walking: bool = False,
) -> MotionClip:
    """The clip of a plan.

    Args:
        wanted_w_m: (T, 22, 3) positions as R2G gives them; row 0 is the last prefix frame.
        contacts: (T, 4) predicted contact of left ankle, left toe, right ankle, right toe, about 0..1.
        fps: rate of the frames.
        hands: sides whose wrist is put where it is wanted.
        toes: planned frames about which the toes of a side are put where they are wanted.
        walking: toes are kept where they stand and a foot that swings clears the floor; else the ankle is kept, by the
            contact of heel or toes.

    Returns:
        the T - 1 planned frames, bone lengths exact.
    """
    body = clip_from_positions(wanted_w_m, fps, rebuild=True).positions_w_m.copy()
    points_stand: Bools = np.asarray((contacts > CONTACT).reshape(-1, 2, 2))
    stands: Bools = np.asarray(points_stand.any(-1))
    for number, side in enumerate(("left", "right")):
        ankle, toe = CANONICAL.index(f"{side}_ankle"), CANONICAL.index(f"{side}_foot")
        heel_stands, toes_stand = points_stand[:, number].T
        target = wanted_w_m[:, ankle].copy()
        target[:, :2] += held_offsets(target[:, :2], heel_stands if walking else stands[:, number])
        body = solve_leg(body, side, target)
        if walking:
            slow = np.linalg.norm(np.gradient(body[:, toe, :2], axis=0), axis=-1) * fps < TOES_SLOW_MPS
            target = body[:, ankle].copy()
            target[:, :2] += held_offsets(body[:, toe, :2], toes_stand & slow)
            body = solve_leg(body, side, target)
        if side in toes:
            numbers = np.arange(len(body))[:, None]
            near = np.exp(-((numbers - 1 - np.asarray(toes[side])) ** 2) / (2 * TOES_FRAMES**2)).max(-1, keepdims=True)
            for _ in range(TOES_TIMES):
                body = solve_leg(body, side, body[:, ankle] + near * (wanted_w_m[:, toe] - body[:, toe]))
        sole = np.minimum(*(body[:, j, 2] - CANONICAL.rest_positions_m[j, 2] for j in (ankle, toe)))
        swings = walking & stands[:, 1 - number] & ~stands[:, number]
        least = CLEAR_M * np.where(swings, swiftness(body[:, [ankle, toe], :2], fps), 0.0)
        lifted = body[:, ankle].copy()
        lifted[:, 2] += np.maximum(least - sole, 0.0)
        body = solve_leg(body, side, lifted)
        if side in hands:
            body = solve_arm(body, side, wanted_w_m[:, CANONICAL.index(f"{side}_wrist")])
    return clip_from_positions(body[1:], fps, rebuild=True)
