"""What DiP is trained on: x0, targets, heading, and where R2G puts the body (REFERENCE 1).

Positions are seen from the root frame of the last prefix frame, in metres; velocities in metres a second.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import torch
from torch import Tensor

from planner_service.dip.conditions import (
    JOINT_SLOTS,
    KeyframeBatch,
    TargetBatch,
    VelocityBatch,
    heading_at_arrival,
    joints_at_arrival,
    late_velocity,
    slot_axes,
    wrapped_difference,
)
from planner_service.dip.features_torch import plan_to_positions
from shared.motion.features import (
    CONTACTS,
    FEATURES,
    JOINT_POSITIONS,
    JOINT_ROTATIONS,
    JOINT_VELOCITIES,
    ROOT_HEIGHT,
    ROOT_VELOCITY,
    YAW_RATE,
)
from shared.motion.metrics import FOOT_JOINTS
from shared.motion.skeleton import CANONICAL
from shared.protocol.rates import PLANNER_FPS as FPS


@dataclass(frozen=True)
class LossWeights:
    """Weights of the terms; `x0_*` weigh the squared normalised error of a feature group.

    The root's four numbers carry the whole path and would drown among 259 others, so they weigh more; rotations are
    rebuilt from positions and weigh less.
    """

    x0_root: float = 8.0
    x0_positions: float = 1.0
    x0_rotations: float = 0.25
    x0_velocities: float = 0.5
    x0_contacts: float = 1.0
    target: float = 16.0
    heading: float = 1.0
    position: float = 4.0
    velocity: float = 0.4
    acceleration: float = 0.002
    skating: float = 2.0
    keyframe: float = 8.0
    desired_velocity: float = 2.0


GESTURE_WEIGHTS = {"left_wrist": 6.0, "right_wrist": 6.0, "left_elbow": 3.0, "right_elbow": 3.0}
"""Joints that count more: a wave is 8 cm of two joints out of 22, and is smoothed away by a plain mean, even at the
last of the diffusion's steps."""


@cache
def joint_weights(device: torch.device) -> Tensor:
    """(22,) weights of joints with mean 1."""
    out = torch.tensor([GESTURE_WEIGHTS.get(name, 1.0) for name in CANONICAL.names], device=device)
    return out / out.mean()


@cache
def _feet(device: torch.device) -> Tensor:
    """Indices of the joints that touch the floor."""
    return torch.from_numpy(CANONICAL.indices(*FOOT_JOINTS)).to(device)


def feature_weights(w: LossWeights) -> Tensor:
    """(263,) weights with mean 1."""
    out = torch.zeros(FEATURES)
    for part, weight in (
        (YAW_RATE, w.x0_root),
        (ROOT_VELOCITY, w.x0_root),
        (ROOT_HEIGHT, w.x0_root),
        (JOINT_POSITIONS, w.x0_positions),
        (JOINT_ROTATIONS, w.x0_rotations),
        (JOINT_VELOCITIES, w.x0_velocities),
        (CONTACTS, w.x0_contacts),
    ):
        out[part] = weight
    gestures = torch.tensor([GESTURE_WEIGHTS.get(name, 1.0) for name in CANONICAL.names]).repeat_interleave(3)
    out[JOINT_POSITIONS] *= gestures[3:]
    out[JOINT_VELOCITIES] *= gestures
    return out / out.mean()


SLOT_SHARES = {
    "traj": 0.32,
    "pelvis": 0.12,
    "left_wrist": 0.13,
    "right_wrist": 0.13,
    "left_foot": 0.12,
    "right_foot": 0.12,
    "head": 0.06,
}
BESIDE_SHARE = 0.4
"""Of the windows with another joint's place, those with the root's place at that frame beside it: a strike is asked for
by both, and what was never seen together is not understood together."""
FREE_SHARE = 0.5
"""Windows with nothing but a text. A target tells nearly everything about a plan, so a text beside one teaches little:
with 19 % of such windows, "a person walks forward." made slow circles until it was guided far out of the data."""
NO_JOINT_SHARE = 0.2
HEADING_SHARE = 0.5
LAST_FRAME_SHARE = 0.5


def sample_targets(plan: Tensor, first_frame: int, generator: torch.Generator) -> TargetBatch:
    """Targets taken from the clips' own plans (B, N, 263, not normalised): nothing, or one joint, or that and the root,
    or none, with or without heading.

    Arrival frames: half of them the last, the others anywhere from `first_frame` on.
    """
    b, n = plan.shape[:2]
    positions, heading = plan_to_positions(plan, FPS)
    shares = torch.tensor([SLOT_SHARES[s] for s in JOINT_SLOTS])
    slot = torch.multinomial(shares.expand(b, -1), 1, generator=generator).squeeze(-1)

    def chance(p: float) -> Tensor:
        return torch.rand(b, generator=generator) < p

    frame = torch.randint(first_frame, n + 1, (b,), generator=generator)
    frame = torch.where(chance(LAST_FRAME_SHARE), n, frame)
    own = torch.randint(first_frame, n + 1, (b,), generator=generator)
    heading_frame = torch.where(chance(0.8), frame, own)
    frames = frame[:, None].expand(b, len(JOINT_SLOTS))
    free = chance(FREE_SHARE)
    placed = ~(chance(NO_JOINT_SHARE) | free)
    headed = chance(HEADING_SHARE) & ~free
    slots = torch.arange(len(JOINT_SLOTS))
    beside = chance(BESIDE_SHARE)[:, None] & (slots == JOINT_SLOTS.index("traj"))
    return TargetBatch(
        position_m=joints_at_arrival(positions, frames),
        position_valid=((slots == slot[:, None]) | beside) & placed[:, None],
        position_frame=frames,
        heading_rad=heading_at_arrival(heading, heading_frame),
        heading_valid=headed,
        heading_frame=heading_frame,
    )


def dip_loss(
    predicted: Tensor,
    clean: Tensor,
    last_prefix: Tensor,
    mean: Tensor,
    std: Tensor,
    targets: TargetBatch,
    signal: Tensor,
    weights: LossWeights,
    group_weights: Tensor,
    keyframes: KeyframeBatch | None = None,
    velocities: VelocityBatch | None = None,
) -> tuple[Tensor, dict[str, Tensor]]:
    """Loss of predicted against clean plans.

    Args:
        predicted, clean: (B, N, 263), normalised.
        last_prefix: (B, 263) the last prefix frame, not normalised: the plan's first step starts there.
        mean, std: (263,) of the normaliser.
        targets: what the plan was asked to meet.
        signal: (B,) share of the signal left at the diffusion step, 0..1: how much a prediction can know. Fine
            physical terms count by it, since a prediction from noise alone is a mean of many motions.
        weights: of the terms; group_weights: from `feature_weights`.
        keyframes, velocities: what else the plan was asked to meet.

    Returns:
        the loss and its terms, single numbers that no gradient goes through, with errors of targets in metres and
        radians, of keyed joints in metres and of velocities in metres a second. All stay on the device: to read one is
        to wait for it.
    """
    device = predicted.device
    terms = {"x0": ((predicted - clean).square() * group_weights).mean()}
    positions, heading = plan_to_positions(predicted * std + mean, FPS)
    clean_features = clean * std + mean
    with torch.no_grad():
        true_positions, _ = plan_to_positions(clean_features, FPS)
        start = start_pose(last_prefix)

    wanted = targets.position_m * slot_axes(device)
    gap = (joints_at_arrival(positions, targets.position_frame) - wanted).square().sum(-1)
    terms["target"] = (gap * targets.position_valid).sum() / positions.shape[0]
    turn = wrapped_difference(heading_at_arrival(heading, targets.heading_frame), targets.heading_rad)
    terms["heading"] = (turn.square() * targets.heading_valid).sum() / positions.shape[0]
    errors = {}
    if keyframes is not None:
        apart = (positions - keyframes.position_m).square().sum(-1) * keyframes.mask
        held = keyframes.mask.sum((1, 2))
        terms["keyframe"] = (apart.sum((1, 2)) / held.clamp_min(1)).mean()
        errors["keyframe_m"] = _mean_where(apart.detach().sqrt(), keyframes.mask)
    if velocities is not None:
        slip = (late_velocity(positions, FPS) - velocities.velocity_mps).square().sum(-1)
        terms["desired_velocity"] = (slip * velocities.valid).mean()
        errors["desired_velocity_mps"] = _mean_where(slip.detach().sqrt(), velocities.valid)
    joints = joint_weights(device)
    terms["position"] = ((positions - true_positions).square().sum(-1) * joints).mean()

    velocity = torch.diff(torch.cat([start[:, None], positions], dim=1), dim=1) * FPS
    true_velocity = torch.diff(torch.cat([start[:, None], true_positions], dim=1), dim=1) * FPS
    terms["velocity"] = (((velocity - true_velocity).square().sum(-1) * joints).mean((1, 2)) * signal).mean()
    change, true_change = (torch.diff(v, dim=1) * FPS for v in (velocity, true_velocity))
    terms["acceleration"] = ((change - true_change).square().sum(-1).mean((1, 2)) * signal).mean()
    feet = velocity[:, :, _feet(device)]
    stance = clean_features[..., CONTACTS]
    terms["skating"] = ((feet[..., :2].square().sum(-1) * stance).mean((1, 2)) * signal).mean()

    total = sum((getattr(weights, name, 1.0) * value for name, value in terms.items()), torch.zeros((), device=device))
    numbers = {**{name: value.detach() for name, value in terms.items()}, **errors}
    with torch.no_grad():
        numbers["target_m"] = _mean_where(gap.sqrt().flatten(), targets.position_valid.flatten())
        numbers["heading_rad"] = _mean_where(turn.abs(), targets.heading_valid)
    return total, numbers


def start_pose(last_prefix: Tensor) -> Tensor:
    """Positions (B, 22, 3) of the last prefix frame (B, 263) in its own root frame."""
    still = last_prefix.clone()
    still[:, YAW_RATE] = 0.0
    still[:, ROOT_VELOCITY] = 0.0
    return plan_to_positions(still[:, None], FPS)[0][:, 0]


def _mean_where(values: Tensor, mask: Tensor) -> Tensor:
    """Mean of the chosen values; 0 if there are none."""
    return (values * mask).sum() / mask.sum().clamp_min(1)
