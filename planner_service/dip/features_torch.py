"""R2G in torch: differentiable twin of `shared.motion.features.features_to_global`, and DiP's normaliser."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from shared.motion.features import JOINT_POSITIONS, JOINTS, ROOT_HEIGHT, ROOT_VELOCITY, YAW_RATE


def rotate_z(vectors: Tensor, angle: Tensor) -> Tensor:
    """Vectors (..., 2 or 3) turned by `angle` (...) radians about Z."""
    c, s = torch.cos(angle), torch.sin(angle)
    x, y = vectors[..., 0], vectors[..., 1]
    return torch.cat([torch.stack([c * x - s * y, s * x + c * y], dim=-1), vectors[..., 2:]], dim=-1)


def plan_to_positions(plan: Tensor, fps: float) -> tuple[Tensor, Tensor]:
    """World positions of a plan seen from the root frame of the frame before it (the last prefix frame).

    Args:
        plan: (..., N, 263) features, not normalised; rates look back, so row 0 leads from the last prefix frame.
        fps: frames per second.

    Returns:
        positions_m (..., N, 22, 3) and heading_rad (..., N), not wrapped.
    """
    heading = torch.cumsum(plan[..., YAW_RATE].squeeze(-1) / fps, dim=-1)
    before = torch.cat([torch.zeros_like(heading[..., :1]), heading[..., :-1]], dim=-1)
    xy = torch.cumsum(rotate_z(plan[..., ROOT_VELOCITY] / fps, before), dim=-2)
    joints = plan[..., JOINT_POSITIONS].reshape(plan.shape[:-1] + (JOINTS - 1, 3))
    height = plan[..., ROOT_HEIGHT]
    root = torch.cat([torch.zeros_like(height), torch.zeros_like(height), height], dim=-1)
    turned = rotate_z(torch.cat([root[..., None, :], joints], dim=-2), heading[..., None])
    return torch.cat([turned[..., :2] + xy[..., None, :], turned[..., 2:]], dim=-1), heading


@dataclass(frozen=True)
class Normalizer:
    """Mean and standard deviation (263,) of the features; travels inside the weights."""

    mean: Tensor
    std: Tensor

    def normalize(self, features: Tensor) -> Tensor:
        """Features (..., 263) -> zero mean, unit spread."""
        return (features - self.mean) / self.std

    def denormalize(self, features: Tensor) -> Tensor:
        """Inverse of `normalize`."""
        return features * self.std + self.mean
