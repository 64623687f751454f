"""The learned model of the simulator: from state and servo targets to the state one tick later.

A network gives the change of the velocities over a tick and small corrections of trapezoidal integration; positions
follow by exact integration, so that the model cannot forget what a velocity is. Everything it sees and says is in the
heading frame.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from shared.protocol.rates import TICK_HZ
from tracker_service.training.network import mlp
from tracker_service.training.world.body import (
    Bodies,
    State,
    heading_frame,
    into,
    out_of,
    rotation_of,
    small_matmul,
)

TICK_S = 1.0 / TICK_HZ
FEATURE_CLIP = 6.0


class WorldModel(nn.Module):
    """See the module's docstring. J bodies, H hinges, K support heights.

    Args:
        bodies, hinges, heights: J, H, K. hidden: sizes of the layers.
    """

    mean: Tensor
    std: Tensor
    scale: Tensor

    def __init__(self, bodies: int, hinges: int, heights: int, hidden: tuple[int, ...] = (512, 512)):
        super().__init__()
        self.hinges = hinges
        features = 1 + 6 + 3 + 3 + 3 * hinges + 3 * (bodies - 1) + 3 * bodies + heights
        changes = 12 + 2 * hinges
        self.net = mlp([features, *hidden, changes], 0.01)
        self.register_buffer("mean", torch.zeros(features))
        self.register_buffer("std", torch.ones(features))
        self.register_buffer("scale", torch.ones(changes))

    def features(self, state: State, bodies: Bodies, target_rad: Tensor, heights: Tensor) -> Tensor:
        """(B, F) what the network sees."""
        frame = heading_frame(state.rot_w)
        pos = bodies.pos_w_m
        parts = [
            pos[:, 0, 2:],
            into(frame, state.rot_w[:, :, :2].transpose(1, 2)).flatten(1),
            into(frame, state.linvel_w_mps[:, None]).flatten(1),
            state.angvel_b_radps,
            state.hinge_rad,
            0.1 * state.rate_radps,
            target_rad - state.hinge_rad,
            into(frame, pos[:, 1:] - pos[:, :1]).flatten(1),
            into(frame, bodies.linvel_w_mps).flatten(1),
            heights,
        ]
        return torch.cat(parts, -1)

    def inputs(self, state: State, bodies: Bodies, target_rad: Tensor, heights: Tensor) -> Tensor:
        """(B, F) features, normalised and clipped."""
        x = (self.features(state, bodies, target_rad, heights) - self.mean) / self.std
        return x.clamp(-FEATURE_CLIP, FEATURE_CLIP)

    def forward(self, state: State, bodies: Bodies, target_rad: Tensor, heights: Tensor) -> State:
        """The state one tick later."""
        change: Tensor = self.net(self.inputs(state, bodies, target_rad, heights)) * self.scale
        return self.moved(state, change)

    def moved(self, s: State, change: Tensor) -> State:
        """Exact integration of a change (B, 12+2H) of velocities, with small corrections of the integral."""
        h = self.hinges
        frame = heading_frame(s.rot_w)
        vel = s.linvel_w_mps + out_of(frame, change[:, :3])
        ang = s.angvel_b_radps + change[:, 3:6]
        rate = s.rate_radps + change[:, 6 : 6 + h]
        pos = s.pos_w_m + TICK_S / 2 * (s.linvel_w_mps + vel) + out_of(frame, change[:, 6 + h : 9 + h])
        turn = TICK_S / 2 * (s.angvel_b_radps + ang) + change[:, 9 + h : 12 + h]
        hinge = s.hinge_rad + TICK_S / 2 * (s.rate_radps + rate) + change[:, 12 + h :]
        return State(pos, small_matmul(s.rot_w, rotation_of(turn)), hinge, vel, ang, rate)

    @torch.no_grad()
    def change_of(self, s: State, n: State) -> Tensor:
        """(B, 12+2H) what the network should have said for a transition from `s` to `n` (for normalisation)."""
        frame = heading_frame(s.rot_w)
        gone = n.pos_w_m - s.pos_w_m - TICK_S / 2 * (s.linvel_w_mps + n.linvel_w_mps)
        rel = small_matmul(s.rot_w.transpose(1, 2), n.rot_w)
        turned = torch.stack(
            [rel[:, 2, 1] - rel[:, 1, 2], rel[:, 0, 2] - rel[:, 2, 0], rel[:, 1, 0] - rel[:, 0, 1]], -1
        )
        return torch.cat(
            [
                into(frame, (n.linvel_w_mps - s.linvel_w_mps)[:, None])[:, 0],
                n.angvel_b_radps - s.angvel_b_radps,
                n.rate_radps - s.rate_radps,
                into(frame, gone[:, None])[:, 0],
                turned / 2 - TICK_S / 2 * (s.angvel_b_radps + n.angvel_b_radps),
                n.hinge_rad - s.hinge_rad - TICK_S / 2 * (s.rate_radps + n.rate_radps),
            ],
            -1,
        )

    @torch.no_grad()
    def normalize_by(self, s: State, bodies: Bodies, target_rad: Tensor, heights: Tensor, n: State) -> None:
        """Take mean and spread of features and changes from transitions; a feature that never varies keeps a spread
        of 0.1, so that the first seat is no shock."""
        x = self.features(s, bodies, target_rad, heights)
        self.mean.copy_(x.mean(0))
        std = x.std(0)
        self.std.copy_(torch.where(std < 1e-6, torch.full_like(std, 0.1), std + 1e-3))
        self.scale.copy_(self.change_of(s, n).std(0) + 1e-5)


def model_loss(model: WorldModel, got: State, true: State) -> Tensor:
    """Mean absolute error of a predicted state, velocities in units of their usual change over a tick."""
    h = model.hinges
    scale = model.scale
    return (
        (got.linvel_w_mps - true.linvel_w_mps).abs().mean() / scale[:3].mean()
        + (got.angvel_b_radps - true.angvel_b_radps).abs().mean() / scale[3:6].mean()
        + ((got.rate_radps - true.rate_radps) / scale[6 : 6 + h]).abs().mean()
        + (got.pos_w_m - true.pos_w_m).abs().mean() / 0.02
        + (got.rot_w - true.rot_w).abs().mean() / 0.03
        + (got.hinge_rad - true.hinge_rad).abs().mean() / 0.05
    )
