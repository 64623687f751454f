"""What DiP can be told besides text: places of joints and a heading, each at an arrival frame (DESIGN 4).

Slots are seen from the root frame of the LAST PREFIX frame (its place on the floor and its heading), in training and
in use alike (REFERENCE 4.3). `traj` is the root on the floor: its z counts for nothing. A heading is the pair
(cos, sin). An arrival frame counts plan frames from 1.
"""

from __future__ import annotations

from dataclasses import dataclass

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
                    self.position_m * SLOT_AXES,
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


def joints_at_arrival(positions_m: Tensor, frames: Tensor) -> Tensor:
    """Slot joints at their arrival frames.

    Args:
        positions_m: (B, N, 22, 3) plan in the root frame of the last prefix frame.
        frames: (B, 7) arrival frames from 1.

    Returns:
        (B, 7, 3), z of `traj` zero.
    """
    batch = torch.arange(positions_m.shape[0])[:, None]
    return positions_m[batch, frames - 1, SLOT_JOINTS] * SLOT_AXES


def heading_at_arrival(heading_rad: Tensor, frames: Tensor) -> Tensor:
    """Heading (B,) of plans (B, N) at arrival frames (B,) from 1."""
    return heading_rad[torch.arange(heading_rad.shape[0]), frames - 1]


def wrapped_difference(a_rad: Tensor, b_rad: Tensor) -> Tensor:
    """a - b on the circle, in (-pi, pi]: wraps at 2 pi, so facing backwards is as wrong as can be (REFERENCE 4.2)."""
    d = a_rad - b_rad
    return torch.atan2(torch.sin(d), torch.cos(d))
