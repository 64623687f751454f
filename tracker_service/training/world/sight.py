"""What policy and critic see, and what a tick is worth, in torch with gradients.

The same functions as `policy.observations`, `training.rewards` and `TrackingEnv` have in numpy for the simulator;
tests/tracker/test_world_training.py holds them together. B is the batch, J = 22 bodies, H hinges, K support heights.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from shared.plugins.interfaces import GROUND_GRID_M
from shared.protocol.rates import TICK_HZ
from tracker_service.policy.observations import FEEDFORWARD_LIMIT_RAD
from tracker_service.training.seats import BACK_SIZE_M, EDGE_M, SEAT_SIZE_M, SOFA_SIZE_M
from tracker_service.training.world.body import Bodies, State, heading_frame, into, small_matmul

STILL_MPS = 0.25


@dataclass(frozen=True)
class Reference:
    """What is to be followed, at one tick and those after it.

    Attributes:
        pos_w_m: (B, J, 3) at the next tick. later_pos_w_m: (B, J, 3) at the fourth next.
        linvel_w_mps: (B, J, 3), rot_xy: (B, J, 2, 3), qvel: (B, 6+H) at the next tick.
        hinge_rad, after_rad, later_rad: (B, H) at the next, second and fourth next tick.
    """

    pos_w_m: Tensor
    later_pos_w_m: Tensor
    linvel_w_mps: Tensor
    rot_xy: Tensor
    qvel: Tensor
    hinge_rad: Tensor
    after_rad: Tensor
    later_rad: Tensor


def observe(state: State, bodies: Bodies, ref: Reference, heights: Tensor) -> Tensor:
    """(B, D) observations: own state, differences to the previewed reference, support heights (B, K)."""
    frame = heading_frame(state.rot_w)
    pos, vel = bodies.pos_w_m, bodies.linvel_w_mps
    root_xy = ref.rot_xy[:, 0]
    third = torch.linalg.cross(root_xy[:, 0], root_xy[:, 1])
    wanted = torch.stack([root_xy[:, 0], root_xy[:, 1], third], -1)
    turn = small_matmul(state.rot_w.transpose(1, 2), wanted)[:, :, :2].transpose(1, 2)
    spin = small_matmul(state.rot_w, state.angvel_b_radps[..., None])[..., 0]
    parts = [
        pos[:, 0, 2:],
        into(frame, state.rot_w[:, :, :2].transpose(1, 2)).flatten(1),
        into(frame, spin[:, None]).flatten(1),
        into(frame, pos[:, 1:] - pos[:, :1]).flatten(1),
        into(frame, vel).flatten(1),
        state.hinge_rad,
        0.1 * state.rate_radps,
        into(frame, ref.pos_w_m - pos).flatten(1),
        ref.hinge_rad - state.hinge_rad,
        into(frame, ref.later_pos_w_m - pos).flatten(1),
        ref.later_rad - state.hinge_rad,
        into(frame, ref.linvel_w_mps - vel).flatten(1),
        turn.flatten(1),
        heights,
    ]
    return torch.cat(parts, -1)


def servo_targets(action: Tensor, ref: Reference, lead: Tensor, scale: float, limits: tuple[Tensor, Tensor]) -> Tensor:
    """(B, H) servo targets of actions (B, H): the led reference plus the scaled action, within the hinges' limits.

    Args:
        lead: (H,) ticks by which the servo trails: damping over stiffness times the rate.
    """
    ahead = ((ref.after_rad - ref.hinge_rad) * lead).clamp(-FEEDFORWARD_LIMIT_RAD, FEEDFORWARD_LIMIT_RAD)
    wanted = ref.hinge_rad + ahead + scale * action.clamp(-1.0, 1.0)
    return torch.minimum(torch.maximum(wanted, limits[0]), limits[1])


def tick_reward(state: State, bodies: Bodies, ref: Reference) -> tuple[Tensor, Tensor]:
    """Reward (B,) of having arrived at a state, and joint distances (B, J). `ref` is of the tick arrived at.

    The terms and weights are those of `TrackingEnv.advance`, without the cost of the action.
    """
    square = ((bodies.pos_w_m - ref.pos_w_m) ** 2).sum(-1)
    a, b = bodies.rot_w[..., 0], bodies.rot_w[..., 1]
    u, v = ref.rot_xy[..., 0, :], ref.rot_xy[..., 1, :]
    au, av, bu, bv = (a * u).sum(-1), (a * v).sum(-1), (b * u).sum(-1), (b * v).sum(-1)
    cosine = ((au + bv + au * bv - av * bu - 1.0) / 2.0).clamp(-0.9999, 0.9999)
    angle = torch.arccos(cosine)
    mean = square.mean(-1)
    reward = (
        0.4 * torch.exp(-100.0 * mean)
        + 0.1 * torch.exp(-10.0 * mean)
        + 0.3 * torch.exp(-10.0 * (angle**2).mean(-1))
        + 0.1 * torch.exp(-((bodies.linvel_w_mps - ref.linvel_w_mps) ** 2).sum(-1).mean(-1))
        + 0.1 * torch.exp(-0.1 * ((state.rate_radps - ref.qvel[:, 6:]) ** 2).mean(-1))
    )
    return reward, (square + 1e-12).sqrt()


def still_tracked(distance: Tensor, stop_mean_m: float, stop_max_m: float, slack: Tensor) -> Tensor:
    """(B,) whether joint distances (B, J) let an episode go on, the limits times the slack (B,) of its clip."""
    return (distance.mean(-1) < stop_mean_m * slack) & (distance.max(-1).values < stop_max_m * slack)


def trembling(before: Bodies, after: Bodies, wanted_mps: Tensor) -> Tensor:
    """(B,) mean squared acceleration of the joints ((m/s^2)^2) from one tick to the next, as far as a reference with
    joint velocities (B, J, 3) stands still with all of them: a fist that sets out is not to be held back."""
    acceleration = (after.linvel_w_mps - before.linvel_w_mps) * TICK_HZ
    still = torch.exp(-((wanted_mps.norm(dim=-1).amax(-1) / STILL_MPS) ** 2))
    return still * (acceleration**2).sum(-1).mean(-1)


@torch.no_grad()
def support_heights(bodies: Bodies, seat: Tensor, feet: tuple[int, int]) -> Tensor:
    """(B, HEIGHTS) heights of seats (B, 5) at the points of `training.seats.height_points`."""
    pos = bodies.pos_w_m
    forward = bodies.rot_w[:, 0, :2, 0]
    ahead = forward / forward.norm(dim=-1, keepdim=True).clamp(min=1e-6)
    left = torch.stack([-ahead[:, 1], ahead[:, 0]], -1)
    root = pos[:, 0, :2]
    grid = [root + a * ahead + b * left for a in GROUND_GRID_M for b in GROUND_GRID_M]
    points = torch.stack([*grid, pos[:, feet[0], :2], pos[:, feet[1], :2], root], 1)
    offset = points - seat[:, None, :2]
    c, s = seat[:, 3:4].cos(), seat[:, 3:4].sin()
    behind = EDGE_M - (c * offset[..., 0] + s * offset[..., 1])
    across = (c * offset[..., 1] - s * offset[..., 0]).abs()
    sofa, top, pelvis = seat[:, 4:] > 0, seat[:, 2:3], pos[:, :1, 2]
    deep, wide = (torch.where(sofa, SOFA_SIZE_M[i], SEAT_SIZE_M[i]) for i in range(2))
    over = (behind >= 0) & (behind <= deep) & (across <= wide / 2) & (top > 0)
    back = over & sofa & (behind >= deep - BACK_SIZE_M[0]) & (top + BACK_SIZE_M[2] < pelvis)
    return torch.where(back, top + BACK_SIZE_M[2], torch.where(over & (top < pelvis), top, torch.zeros_like(behind)))
