"""What DiP can be told besides text: places of joints and a heading at an arrival frame, keyframes and a velocity.

Weights may have been trained without keyframes and velocity; `DipConfig.extra_conditions` says what they take.

Slots are seen from the root frame of the LAST PREFIX frame (its place on the floor and its heading), in training and
in use alike (REFERENCE 4.3). `traj` is the root on the floor: its z counts for nothing. A heading is the pair
(cos, sin). An arrival frame counts plan frames from 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import torch
from torch import Tensor

from shared.motion.skeleton import CANONICAL

JOINT_SLOTS = ("pelvis", "left_foot", "right_foot", "left_wrist", "right_wrist", "head", "traj")
HEADING_SLOT = "heading"
SLOTS = (*JOINT_SLOTS, HEADING_SLOT)
NUMBERS_PER_SLOT = 5
"""x, y, z (or cos, sin, 0), valid, arrival."""
TARGET_NUMBERS = len(SLOTS) * NUMBERS_PER_SLOT

SLOT_JOINTS = torch.tensor([CANONICAL.index("pelvis" if slot == "traj" else slot) for slot in JOINT_SLOTS])
"""(7,) skeleton joint of each joint slot."""
SLOT_AXES = torch.tensor([[1.0, 1.0, 0.0 if slot == "traj" else 1.0] for slot in JOINT_SLOTS])
"""(7, 3) which axes of a joint slot count."""


@cache
def slot_axes(device: torch.device) -> Tensor:
    """SLOT_AXES on a device."""
    return SLOT_AXES.to(device)


@cache
def _slot_joints(device: torch.device) -> Tensor:
    return SLOT_JOINTS.to(device)


KEYFRAME_NUMBERS = 22 * 3 + 22
"""Of one plan frame: places of all joints, and which of them hold."""
VELOCITY_NUMBERS = 3
"""x, y, valid."""


@dataclass(frozen=True)
class TargetBatch:
    """Targets of B windows in the root frame of their last prefix frame.

    Attributes:
        position_m: (B, 7, 3); position_valid: (B, 7) bool; position_frame: (B, 7) int64, 1..plan_frames.
        heading_rad: (B,); heading_valid: (B,) bool; heading_frame: (B,) int64.
    """

    position_m: Tensor
    position_valid: Tensor
    position_frame: Tensor
    heading_rad: Tensor
    heading_valid: Tensor
    heading_frame: Tensor

    @staticmethod
    def none(batch: int, plan_frames: int) -> TargetBatch:
        """No target at all."""
        slots = len(JOINT_SLOTS)
        return TargetBatch(
            torch.zeros(batch, slots, 3),
            torch.zeros(batch, slots, dtype=torch.bool),
            torch.full((batch, slots), plan_frames),
            torch.zeros(batch),
            torch.zeros(batch, dtype=torch.bool),
            torch.full((batch,), plan_frames),
        )

    def vector(self, plan_frames: int) -> Tensor:
        """(B, TARGET_NUMBERS) the network's input; an unused slot is all zero."""
        joint = (
            torch.cat(
                [
                    self.position_m * slot_axes(self.position_m.device),
                    torch.ones_like(self.position_m[..., :1]),
                    (self.position_frame / plan_frames)[..., None],
                ],
                dim=-1,
            )
            * self.position_valid[..., None]
        )
        heading = (
            torch.stack(
                [
                    torch.cos(self.heading_rad),
                    torch.sin(self.heading_rad),
                    torch.zeros_like(self.heading_rad),
                    torch.ones_like(self.heading_rad),
                    self.heading_frame / plan_frames,
                ],
                dim=-1,
            )
            * self.heading_valid[..., None]
        )
        return torch.cat([joint.flatten(1), heading], dim=-1).float()


@dataclass(frozen=True)
class KeyframeBatch:
    """Places that joints pass through at frames of B plans, in the root frame of their last prefix frame.

    Attributes:
        position_m: (B, N, 22, 3), whatever it is where `mask` (B, N, 22) bool is False.
    """

    position_m: Tensor
    mask: Tensor

    @staticmethod
    def none(batch: int, plan_frames: int) -> KeyframeBatch:
        """No keyframe at all."""
        joints = len(CANONICAL.names)
        return KeyframeBatch(
            torch.zeros(batch, plan_frames, joints, 3), torch.zeros(batch, plan_frames, joints, dtype=torch.bool)
        )

    def vector(self) -> Tensor:
        """(B, N, KEYFRAME_NUMBERS) the network's input; zero where there is no key."""
        places = torch.where(self.mask[..., None], self.position_m, 0.0)
        return torch.cat([places.flatten(2), self.mask.float()], dim=-1).float()


@dataclass(frozen=True)
class VelocityBatch:
    """Desired mean velocity of the root on the floor over the second half of B plans.

    Attributes:
        velocity_mps: (B, 2) in the root frame of the last prefix frame; valid: (B,) bool.
    """

    velocity_mps: Tensor
    valid: Tensor

    @staticmethod
    def none(batch: int) -> VelocityBatch:
        """No velocity asked for."""
        return VelocityBatch(torch.zeros(batch, 2), torch.zeros(batch, dtype=torch.bool))

    def vector(self) -> Tensor:
        """(B, VELOCITY_NUMBERS) the network's input; zero where none is asked for."""
        valid = self.valid[:, None]
        return torch.cat([torch.where(valid, self.velocity_mps, 0.0), valid.float()], dim=-1).float()


def late_velocity(positions_m: Tensor, fps: float) -> Tensor:
    """(B, 2) mean velocity of the root on the floor over the second half of plans (B, N, 22, 3), m/s.

    A plan begins with the speed the body has; the half of it after that is what can be asked for.
    """
    first, last = positions_m.shape[1] // 2, positions_m.shape[1]
    return (positions_m[:, last - 1, 0, :2] - positions_m[:, first - 1, 0, :2]) * (fps / (last - first))


def joints_at_arrival(positions_m: Tensor, frames: Tensor) -> Tensor:
    """Slot joints at their arrival frames.

    Args:
        positions_m: (B, N, 22, 3) plan in the root frame of the last prefix frame.
        frames: (B, 7) arrival frames from 1.

    Returns:
        (B, 7, 3), z of `traj` zero.
    """
    device = positions_m.device
    batch = torch.arange(positions_m.shape[0], device=device)[:, None]
    return positions_m[batch, frames - 1, _slot_joints(device)] * slot_axes(device)


def heading_at_arrival(heading_rad: Tensor, frames: Tensor) -> Tensor:
    """Heading (B,) of plans (B, N) at arrival frames (B,) from 1."""
    return heading_rad[torch.arange(heading_rad.shape[0], device=heading_rad.device), frames - 1]


def wrapped_difference(a_rad: Tensor, b_rad: Tensor) -> Tensor:
    """a - b on the circle, in (-pi, pi]: wraps at 2 pi, so facing backwards is as wrong as can be (REFERENCE 4.2)."""
    d = a_rad - b_rad
    return torch.atan2(torch.sin(d), torch.cos(d))
