"""What the policy sees: one pure function, used in training on hundreds of characters and in service on a few.

Everything is expressed in the heading frame: origin at the pelvis, X along the pelvis' heading, Z up. So the policy
neither knows nor cares where it is or where north lies.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.floating]

PREVIEW_TICKS = (1, 4)
"""Which coming reference ticks are seen: the next and the fourth next (REFERENCE 6)."""

FEEDFORWARD_LIMIT_RAD = 1.0
"""The most a servo target leads the reference to make up for the servo's lag (damping / stiffness times the rate)."""


@dataclass(frozen=True)
class PolicyInput:
    """A batch of B characters, world frame. J bodies, H hinges.

    Attributes:
        pos_w_m, linvel_w_mps: (B, J, 3). root_rot_w: (B, 3, 3). root_angvel_w_radps: (B, 3).
        hinge_rad, hinge_vel_radps: (B, H).
        ref_pos_w_m: (B, P, J, 3) reference at the P previewed ticks. ref_linvel_w_mps: (B, J, 3) and ref_root_rot_w:
            (B, 3, 3) at the next tick. ref_hinge_rad: (B, P, H).
    """

    pos_w_m: Array
    linvel_w_mps: Array
    root_rot_w: Array
    root_angvel_w_radps: Array
    hinge_rad: Array
    hinge_vel_radps: Array
    ref_pos_w_m: Array
    ref_linvel_w_mps: Array
    ref_root_rot_w: Array
    ref_hinge_rad: Array


def observation_size(bodies: int, hinges: int) -> int:
    """Length of the vector `observe` makes."""
    previews = len(PREVIEW_TICKS)
    own = 1 + 6 + 3 + 3 * (bodies - 1) + 3 * bodies + 2 * hinges
    return own + previews * (3 * bodies + hinges) + 3 * bodies + 6


def observe(x: PolicyInput) -> npt.NDArray[np.float32]:
    """(B, observation_size) float32. Order: own state, then for each preview position and hinge differences, then
    velocity difference and relative root rotation at the next tick."""
    batch = x.pos_w_m.shape[0]
    forward = x.root_rot_w[:, :, 0]
    norm = np.maximum(np.hypot(forward[:, 0], forward[:, 1]), 1e-6)
    c, s = forward[:, 0] / norm, forward[:, 1] / norm
    to_heading = np.zeros((batch, 3, 3), dtype=np.float64)  # transposed: row vectors are multiplied from the left
    to_heading[:, 0, 0], to_heading[:, 0, 1] = c, -s
    to_heading[:, 1, 0], to_heading[:, 1, 1] = s, c
    to_heading[:, 2, 2] = 1.0
    root = x.pos_w_m[:, :1]
    own_pos = (x.pos_w_m[:, 1:] - root) @ to_heading
    own_vel = x.linvel_w_mps @ to_heading
    tilt = x.root_rot_w[:, :, :2].swapaxes(-1, -2) @ to_heading  # (B, 2, 3)
    spin = x.root_angvel_w_radps[:, None] @ to_heading
    parts = [
        x.pos_w_m[:, 0, 2:],
        tilt.reshape(batch, -1),
        spin.reshape(batch, -1),
        own_pos.reshape(batch, -1),
        own_vel.reshape(batch, -1),
        x.hinge_rad,
        0.1 * x.hinge_vel_radps,
    ]
    for k in range(len(PREVIEW_TICKS)):
        gap = (x.ref_pos_w_m[:, k] - x.pos_w_m) @ to_heading
        parts += [gap.reshape(batch, -1), x.ref_hinge_rad[:, k] - x.hinge_rad]
    vel_gap = (x.ref_linvel_w_mps - x.linvel_w_mps) @ to_heading
    turn = (x.root_rot_w.swapaxes(-1, -2) @ x.ref_root_rot_w)[:, :, :2].swapaxes(-1, -2)
    parts += [vel_gap.reshape(batch, -1), turn.reshape(batch, -1)]
    return np.concatenate(parts, axis=-1).astype(np.float32)


def feedforward_targets(ref_next_rad: Array, ref_after_rad: Array, rate_hz: float, damping_ratio_s: Array) -> Array:
    """Servo targets (B, H) that make stiff-and-damped servos follow the reference without lag.

    A servo kp (u - q) - kd q' trails a moving target by kd/kp seconds; adding kd/kp times the reference's rate cancels
    that.

    Args:
        ref_next_rad, ref_after_rad: (B, H) reference at the next tick and the one after it.
        rate_hz: ticks per second. damping_ratio_s: (H,) kd/kp.
    """
    lead = (ref_after_rad - ref_next_rad) * (rate_hz * damping_ratio_s)
    return np.asarray(ref_next_rad + np.clip(lead, -FEEDFORWARD_LIMIT_RAD, FEEDFORWARD_LIMIT_RAD))
