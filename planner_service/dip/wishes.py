"""What requests ask for as DiP's conditions, at plan frames and seen from the root frame of the last prefix frame.

Keyframes and a velocity become conditions only for weights that take them; the service reports them otherwise.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from planner_service.dip.aiming import Aim, aims_of
from planner_service.dip.conditions import JOINT_SLOTS, KeyframeBatch, TargetBatch, VelocityBatch
from planner_service.dip.config import DipConfig
from shared.motion.features import RootState, to_root_frame
from shared.motion.rotations import wrap_angle
from shared.protocol.messages import PLANNER_FPS, TICK_HZ, PlanRequest

Array = npt.NDArray[np.float64]

LEAST_REACH_M = 0.5
"""A target this near is never moved, however soon it is due."""
ARM_M = 1.0
"""Within it nothing is scaled: a share of the way is about going somewhere, not about where a hand strikes."""
TOP_SPEED_MPS = 4.0
"""A desired velocity is cut to this: hardly a training window runs faster."""
_KICK = re.compile(r"\bkick")


@dataclass(frozen=True)
class Wishes:
    """Conditions of B requests.

    Attributes:
        targets: (B, TARGET_NUMBERS). aims: the same places, to be kept while a plan is sampled.
        keyframes: (B, N, KEYFRAME_NUMBERS) and velocity: (B, VELOCITY_NUMBERS); None for weights without them.
        placed: for each request, whether a place or a velocity is asked for that guidance on the text would pull
            away from.
        ignored: for each request, what of the conditions these weights take could not be honoured.
    """

    targets: Tensor
    aims: list[Aim]
    keyframes: Tensor | None
    velocity: Tensor | None
    placed: list[bool]
    ignored: list[list[str]]

    def only(self, rows: Sequence[int]) -> Wishes:
        """Those of some of the requests, in this order."""
        picked = list(rows)
        return Wishes(
            targets=self.targets[picked],
            aims=[replace(aim, row=new) for new, row in enumerate(picked) for aim in self.aims if aim.row == row],
            keyframes=None if self.keyframes is None else self.keyframes[picked],
            velocity=None if self.velocity is None else self.velocity[picked],
            placed=[self.placed[row] for row in picked],
            ignored=[self.ignored[row] for row in picked],
        )


def read_wishes(
    requests: Sequence[PlanRequest], states: Sequence[RootState], config: DipConfig, step_m: float
) -> Wishes:
    """Conditions of requests whose last prefix frames have the root frames `states`.

    `step_m` is what running covers in a full plan: places farther than that are moved nearer.
    """
    frames = config.plan_frames
    kicks = [_KICK.search((request.text or "").lower()) is not None for request in requests]
    targets = TargetBatch.none(len(requests), frames)
    keys = KeyframeBatch.none(len(requests), frames) if config.keyframes else None
    velocity = VelocityBatch.none(len(requests)) if config.velocity else None
    ignored: list[list[str]] = []
    for row, (request, state) in enumerate(zip(requests, states, strict=True)):
        unused = _put_targets(targets, row, request, state, config, step_m)
        if keys is not None:
            unused += _put_keyframes(keys, row, request, state, step_m)
        wanted = request.desired_velocity_w_mps
        if velocity is not None and wanted is not None:
            velocity.velocity_mps[row] = torch.from_numpy(_seen_velocity(wanted, state))
            velocity.valid[row] = True
        ignored.append(unused)
    placed = [bool(valid.any()) for valid in targets.position_valid]
    if keys is not None:
        placed = [before or bool(mask.any()) for before, mask in zip(placed, keys.mask, strict=True)]
    if velocity is not None:
        placed = [before or bool(valid) for before, valid in zip(placed, velocity.valid, strict=True)]
    return Wishes(
        targets=targets.vector(frames),
        aims=aims_of(targets, keys, kicks),
        keyframes=None if keys is None else keys.vector(),
        velocity=None if velocity is None else velocity.vector(),
        placed=placed,
        ignored=ignored,
    )


def _put_targets(
    batch: TargetBatch, row: int, request: PlanRequest, state: RootState, config: DipConfig, step_m: float
) -> list[str]:
    """Fill a row with the targets and the heading; names of targets that have no slot."""
    unused: list[str] = []
    for target in request.targets:
        if target.joint not in JOINT_SLOTS:
            unused.append(f"target:{target.joint}")
            continue
        slot = JOINT_SLOTS.index(target.joint)
        frame, share = _arrival(request.start_tick, target.arrival_tick, config)
        place = to_root_frame(np.array(target.position_w_m), state)
        batch.position_m[row, slot] = torch.from_numpy(_within_reach(place, frame, share, config, step_m))
        batch.position_valid[row, slot] = True
        batch.position_frame[row, slot] = frame
    if request.heading is not None:
        frame, share = _arrival(request.start_tick, request.heading.arrival_tick, config)
        turn = float(wrap_angle(request.heading.heading_rad - float(state.heading_rad)))
        batch.heading_rad[row] = turn * share
        batch.heading_valid[row] = True
        batch.heading_frame[row] = frame
    return unused


def _arrival(start_tick: int, arrival_tick: int, config: DipConfig) -> tuple[int, float]:
    """Arrival frame within the plan, and the share of the way due by then: below 1 for arrivals beyond its end."""
    wanted = (arrival_tick - start_tick) * PLANNER_FPS / TICK_HZ
    frame = int(np.clip(round(wanted), config.first_arrival_frame, config.plan_frames))
    return frame, min(1.0, config.plan_frames / max(wanted, 1.0))


def _within_reach(place_m: Array, frame: int, share: float, config: DipConfig, step_m: float) -> Array:
    """A target (3,) in the root frame moved toward the root to what a plan can reach by `frame`."""
    distance = float(np.linalg.norm(place_m[:2]))
    reach = step_m * frame / config.plan_frames
    allowed = min(reach, max(distance * share, ARM_M)) if share < 1.0 else reach
    out = place_m.copy()
    out[:2] *= min(1.0, max(allowed, LEAST_REACH_M) / max(distance, 1e-9))
    return out


def _put_keyframes(batch: KeyframeBatch, row: int, request: PlanRequest, state: RootState, step_m: float) -> list[str]:
    """Fill a row with the keys' places; `keyframes:TICK` for each that is past, or due after the plan's last frame.

    A key too far to be reached in time comes nearer as a whole, so that its pose stays what it is.
    """
    unused: list[str] = []
    frames = batch.mask.shape[1]
    for number, tick in enumerate(request.keyframe_ticks.tolist()):
        mask = request.keyframe_mask[number] != 0
        if not mask.any():
            continue
        frame = round((tick - request.start_tick) * PLANNER_FPS / TICK_HZ)
        if not 1 <= frame <= frames:
            unused.append(f"keyframes:{tick}")
            continue
        places = to_root_frame(request.keyframe_positions_w_m[number].astype(np.float64), state)
        middle = places[mask, :2].mean(axis=0)
        distance, allowed = float(np.linalg.norm(middle)), max(step_m * frame / frames, ARM_M)
        places[:, :2] -= middle * (1.0 - min(1.0, allowed / max(distance, 1e-9)))
        joints = torch.from_numpy(mask)
        batch.position_m[row, frame - 1, joints] = torch.from_numpy(places[mask]).float()
        batch.mask[row, frame - 1, joints] = True
    return unused


def _seen_velocity(velocity_w_mps: tuple[float, float], state: RootState) -> Array:
    """(2,) a world velocity seen along the heading, at most TOP_SPEED_MPS."""
    c, s = np.cos(state.heading_rad), np.sin(state.heading_rad)
    x, y = velocity_w_mps
    seen = np.array([c * x + s * y, c * y - s * x])
    return seen * min(1.0, TOP_SPEED_MPS / max(float(np.linalg.norm(seen)), 1e-9))
