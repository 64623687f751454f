"""Plans that keep what they are asked for: in the later steps of the diffusion, joints are put where they should be.

A network only leans toward a place that it is told. Between two of its steps the plan that it foresees can be
corrected; what follows is denoised from the corrected one, so that the rest of the body comes to fit (imputation, as
Karunratanakul et al. 2023 have it for keyframes of motion).

Feet that kick are left to the network: of 25 kicks that were moved to their places 13 succeeded (mean of three runs),
as that throws the body, where 17 did that were not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from planner_service.dip.conditions import JOINT_SLOTS, SLOT_JOINTS, KeyframeBatch, TargetBatch
from planner_service.dip.features_torch import plan_to_positions, rotate_z
from shared.motion.features import JOINT_POSITIONS, JOINT_VELOCITIES, ROOT_HEIGHT, ROOT_VELOCITY
from shared.motion.skeleton import CANONICAL
from shared.protocol.rates import PLANNER_FPS as FPS

AIMED_STEPS = 8
"""In how many of the last steps plans are corrected."""
SPREAD_FRAMES = 4.0
"""Standard deviation of the time about its arrival in which a joint is moved: 0.2 s."""
HEIGHT_SPREAD = 2.0
"""The same for the pelvis' height, as a multiple."""
MOST_M = 0.25
"""A joint is moved by at most this: what is farther off is out of reach, or the plan is not about it."""
MOST_ROOT_MPS = 0.2
"""The way of the root is changed by at most this mean speed, which legs can do."""
UPRIGHT_M = 0.7
"""To a lower pelvis the root is only lifted: of 60 who were put where they should sit 6 fell, of 60 left alone none.
But plans that sink into a high seat push the body off it: of 34 above 0.5 m 24 kept sitting, 30 with the lift."""
ROOT = CANONICAL.index("pelvis")
FEET = frozenset(CANONICAL.index(f"{side}_{name}") for side in ("left", "right") for name in ("ankle", "foot"))
HALFWAY = {"wrist": "elbow", "ankle": "knee", "foot": "knee"}
"""The joint between a limb's end and its root, which moves half as far."""


@dataclass(frozen=True)
class Aim:
    """A place for one joint of one plan of a batch.

    Attributes:
        row: of the batch. joint: of the skeleton. frame: of arrival, from 1. place_m: (3,) in the root frame of the
            last prefix frame. on_floor: whether its height counts for nothing; only_up: whether nothing but its height
        does, and only where the joint would be lower.
        moves: other joints, and which share of the way they go with it.
    """

    row: int
    joint: int
    frame: int
    place_m: Tensor
    on_floor: bool
    only_up: bool
    moves: dict[int, float]


def aims_of(targets: TargetBatch, keyframes: KeyframeBatch | None, kicks: Sequence[bool]) -> list[Aim]:
    """What a batch is asked for, of which some rows kick; first what moves the root, as everything moves with it."""
    found = []
    for row, slot in torch.nonzero(targets.position_valid).tolist():
        joint, frame = int(SLOT_JOINTS[slot]), int(targets.position_frame[row, slot])
        place, traj = targets.position_m[row, slot], JOINT_SLOTS[slot] == "traj"
        if joint in FEET and kicks[row]:
            continue
        low = joint == ROOT and not traj and float(place[2]) < UPRIGHT_M
        found.append(Aim(row, joint, frame, place, traj, low, _moved_with(joint, {joint})))
    if keyframes is not None:
        for row, frame in torch.nonzero(keyframes.mask.any(-1)).tolist():
            keyed = torch.nonzero(keyframes.mask[row, frame]).flatten().tolist()
            for joint in () if kicks[row] and FEET.issuperset(keyed) else keyed:
                place = keyframes.position_m[row, frame, joint]
                found.append(Aim(row, joint, frame + 1, place, False, False, _moved_with(joint, set(keyed))))
    return sorted(found, key=lambda aim: (aim.joint != ROOT, aim.frame))


def _moved_with(joint: int, held: set[int]) -> dict[int, float]:
    """What goes with a joint and is not held itself: what hangs on it, and half as far the middle of its limb."""
    if joint == ROOT:
        return {}
    moves = {joint: 1.0}
    for other in range(joint + 1, len(CANONICAL.names)):
        if CANONICAL.parents[other] in moves and other not in held:
            moves[other] = 1.0
    side, _, kind = CANONICAL.names[joint].partition("_")
    if kind in HALFWAY and (middle := CANONICAL.index(f"{side}_{HALFWAY[kind]}")) not in held:
        moves[middle] = 0.5
    if kind == "foot" and (ankle := CANONICAL.index(f"{side}_ankle")) not in held:
        moves[ankle] = 1.0
    return moves


def hands_of(aims: Sequence[Aim], row: int) -> set[str]:
    """Sides of a plan whose wrist has an aim."""
    names = {CANONICAL.names[aim.joint] for aim in aims if aim.row == row}
    return {side for side in ("left", "right") if f"{side}_wrist" in names}


def toes_of(aims: Sequence[Aim], row: int) -> dict[str, list[int]]:
    """Frames, from 0, in which toes of a plan have an aim, by side."""
    found: dict[str, list[int]] = {}
    for aim in aims:
        side, _, kind = CANONICAL.names[aim.joint].partition("_")
        if aim.row == row and kind == "foot":
            found.setdefault(side, []).append(aim.frame - 1)
    return found


def aimed(plans: Tensor, aims: Sequence[Aim]) -> Tensor:
    """Plans (B, N, 263), not normalised, whose joints come to their aims as far as they may be moved; a new tensor."""
    out = plans.clone()
    for aim in aims:
        if aim.joint == ROOT:
            _move_root(out[aim.row], aim)
    positions, heading = plan_to_positions(out, FPS)
    for aim in aims:
        if aim.joint != ROOT:
            gap = aim.place_m - positions[aim.row, aim.frame - 1, aim.joint]
            _move_joint(out[aim.row], heading[aim.row], _at_most(gap, MOST_M), aim)
    return out


def _move_root(plan: Tensor, aim: Aim) -> None:
    """The body goes more and less quickly to its aim than it did, and from there on as it did."""
    positions, heading = plan_to_positions(plan, FPS)
    gap = aim.place_m - positions[aim.frame - 1, ROOT]
    if not aim.on_floor:
        up = _near(len(plan), aim.frame, HEIGHT_SPREAD * SPREAD_FRAMES)[1:]
        plan[:, ROOT_HEIGHT] += (up * gap[2].clamp(0.0 if aim.only_up else -MOST_M, MOST_M))[:, None]
    if aim.only_up:
        return
    way = _at_most(gap[:2], MOST_ROOT_MPS * aim.frame / FPS)
    share = torch.arange(aim.frame + 1) / aim.frame
    pace = torch.diff(share * share * (3 - 2 * share)) * FPS
    before = torch.cat([torch.zeros(1), heading[: aim.frame - 1]])
    plan[: aim.frame, ROOT_VELOCITY] += rotate_z(way.expand(aim.frame, 2), -before) * pace[:, None]


def _move_joint(plan: Tensor, heading: Tensor, gap: Tensor, aim: Aim) -> None:
    """The joint and what goes with it make a detour over the aim."""
    share = _near(len(plan), aim.frame, SPREAD_FRAMES)
    way = rotate_z(gap.expand(len(plan), 3), -heading)
    for joint, part in aim.moves.items():
        at, speed = JOINT_POSITIONS.start + 3 * (joint - 1), JOINT_VELOCITIES.start + 3 * joint
        plan[:, at : at + 3] += part * share[1:, None] * way
        plan[:, speed : speed + 3] += part * FPS * torch.diff(share)[:, None] * way


def _near(frames: int, frame: int, spread: float) -> Tensor:
    """(frames + 1,) from the last prefix frame on: 1 at `frame`, less before and after, 0 at the start."""
    numbers = torch.arange(frames + 1)
    return torch.exp(-((numbers - frame) ** 2) / (2 * spread**2)) * (numbers / min(frame, spread)).clamp(max=1.0)


def _at_most(way: Tensor, most: float) -> Tensor:
    return way * min(1.0, most / max(float(way.norm()), 1e-9))
