"""What training windows ask for besides text: targets, keyframes and velocities of the windows' own plans."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from planner_service.dip.conditions import (
    JOINT_SLOTS,
    SLOT_JOINTS,
    KeyframeBatch,
    TargetBatch,
    VelocityBatch,
    late_velocity,
)
from planner_service.dip.config import DipConfig
from planner_service.dip.features_torch import plan_to_positions
from planner_service.training.losses import sample_targets
from shared.motion.skeleton import CANONICAL
from shared.protocol.rates import PLANNER_FPS as FPS

ALONE_SHARE = 0.6
"""Of the windows with keyframes or a velocity, those that have no target and no heading beside them."""
MOST_KEYS = 3
MOST_KEYED_JOINTS = 4
WHOLE_POSE_SHARE = 0.3
"""Of the keys, those that hold all joints."""
TWICE_SHARE = 0.4
"""Of the windows with a target of a joint, those that have it as a key at its frame, too, as a strike asks for it."""
LIKELIER_JOINTS = (
    "pelvis", "head", "left_wrist", "right_wrist", "left_ankle", "right_ankle", "left_foot", "right_foot",
)  # fmt: skip
LIKELIER = 4.0
"""How much more often than others these joints are keyed alone: they are what people take hold of."""


@dataclass(frozen=True)
class Asked:
    """What B windows ask for; keyframes and velocity are None for a network that does not take them."""

    targets: TargetBatch
    keyframes: KeyframeBatch | None = None
    velocity: VelocityBatch | None = None

    def any(self) -> Tensor:
        """(B,) bool whether a window asks for anything."""
        out = self.targets.position_valid.any(-1) | self.targets.heading_valid
        if self.keyframes is not None:
            out = out | self.keyframes.mask.flatten(1).any(-1)
        if self.velocity is not None:
            out = out | self.velocity.valid
        return out


def sample_asked(
    plan: Tensor, config: DipConfig, keyed_share: float, velocity_share: float, generator: torch.Generator
) -> Asked:
    """What plans (B, N, 263, not normalised) are asked to do, all of it taken from themselves.

    Of the windows that have a target or a heading, these shares get keyframes and a velocity, most of them instead:
    windows with nothing but their text stay as many as they are. Without these conditions the generator is drawn from
    as it was before there were any.
    """
    targets = sample_targets(plan, config.first_arrival_frame, generator)
    if not config.extra_conditions:
        return Asked(targets)
    asked = targets.position_valid.any(-1) | targets.heading_valid
    positions, _ = plan_to_positions(plan, FPS)
    keyframes = velocity = None
    more = torch.zeros_like(asked)

    def chance(p: float) -> Tensor:
        return torch.rand(len(plan), generator=generator) < p

    if config.keyframes:
        keyed = asked & chance(keyed_share)
        keyframes = KeyframeBatch(
            positions, sample_keys(plan.shape[0], plan.shape[1], generator) & keyed[:, None, None]
        )
        more |= keyed
    if config.velocity:
        velocity = VelocityBatch(late_velocity(positions, FPS), asked & chance(velocity_share))
        more |= velocity.valid
    kept = ~(more & chance(ALONE_SHARE))
    targets = replace(
        targets,
        position_valid=targets.position_valid & kept[:, None],
        heading_valid=targets.heading_valid & kept,
    )
    if keyframes is not None:
        limbs = targets.position_valid & (torch.arange(len(JOINT_SLOTS)) != JOINT_SLOTS.index("traj"))
        row, slot = torch.nonzero(limbs & chance(TWICE_SHARE)[:, None], as_tuple=True)
        keyframes.mask[row, targets.position_frame[row, slot] - 1, SLOT_JOINTS[slot]] = True
    return Asked(targets, keyframes, velocity)


def sample_keys(batch: int, frames: int, generator: torch.Generator) -> Tensor:
    """(B, N, 22) bool: one to MOST_KEYS keys a window at any frames, each of all joints or of one to MOST_KEYED_JOINTS.

    Any frame, as a key comes nearer from plan to plan until it is due in the next frame.
    """
    joints = len(CANONICAL.names)
    weight = torch.tensor([LIKELIER if name in LIKELIER_JOINTS else 1.0 for name in CANONICAL.names])
    keys = torch.randint(1, MOST_KEYS + 1, (batch, 1), generator=generator)
    frame = torch.randint(0, frames, (batch, MOST_KEYS), generator=generator)
    count = torch.randint(1, MOST_KEYED_JOINTS + 1, (batch, MOST_KEYS, 1), generator=generator)
    count = torch.where(torch.rand(batch, MOST_KEYS, 1, generator=generator) < WHOLE_POSE_SHARE, joints, count)
    # The largest of u ** (1 / weight) are a weighted draw without replacement (Efraimidis & Spirakis 2006).
    score = torch.rand(batch, MOST_KEYS, joints, generator=generator) ** (1.0 / weight)
    rank = score.argsort(-1, descending=True).argsort(-1)
    held = (rank < count) & (torch.arange(MOST_KEYS) < keys)[..., None]
    out = torch.zeros(batch, frames, joints)
    out.scatter_add_(1, frame[..., None].expand(-1, -1, joints), held.float())
    return out > 0
