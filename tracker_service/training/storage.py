"""Rollout storage and generalised advantage estimation (Schulman et al. 2016)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

F32 = npt.NDArray[np.float32]
Bools = npt.NDArray[np.bool_]


@dataclass
class Rollout:
    """S steps of B environments.

    Attributes:
        observations: (S, B, D). actions: (S, B, H) before clipping. log_probs, values, rewards: (S, B).
        terminated, truncated, exploded: (S, B).
        truncated_values: (S, B) value of the final observation where truncated, else 0.
        last_values: (B,) value after the last step.
        contrast: (S, B) half the difference of what the action and its mirror image about the mean would bring
            (antithetic advantage), or zeros where it is not measured.
    """

    observations: F32
    actions: F32
    log_probs: F32
    values: F32
    rewards: F32
    terminated: Bools
    truncated: Bools
    exploded: Bools
    truncated_values: F32
    last_values: F32
    contrast: F32

    @classmethod
    def empty(cls, steps: int, envs: int, observation: int, action: int) -> Rollout:
        """All zeros."""

        def grid() -> F32:
            return np.zeros((steps, envs), np.float32)

        def flags() -> Bools:
            return np.zeros((steps, envs), bool)

        return cls(
            np.zeros((steps, envs, observation), np.float32), np.zeros((steps, envs, action), np.float32),
            grid(), grid(), grid(), flags(), flags(), flags(), grid(), np.zeros(envs, np.float32), grid(),
        )  # fmt: skip


def advantages(r: Rollout, gamma: float, lam: float) -> F32:
    """(S, B) generalised advantages.

    A terminated episode is worth nothing after its end; a truncated one is worth the value of its final observation; an
    exploded one has no meaning and gets zero (its samples are to be left out, see `valid`).
    """
    out = np.zeros_like(r.rewards)
    ahead = np.zeros_like(r.last_values)
    next_value = r.last_values
    for t in range(len(r.rewards) - 1, -1, -1):
        done = r.terminated[t] | r.truncated[t] | r.exploded[t]
        following = np.where(r.truncated[t], r.truncated_values[t], np.where(done, 0.0, next_value))
        delta = r.rewards[t] + gamma * following - r.values[t]
        ahead = np.where(r.exploded[t], 0.0, delta + gamma * lam * np.where(done, 0.0, ahead))
        out[t] = ahead
        next_value = r.values[t]
    return out


def valid(r: Rollout) -> Bools:
    """(S, B) samples fit for learning: all but the steps that exploded."""
    return ~r.exploded


def n_tick_worth(r: Rollout, after: F32, unfit: Bools, gamma: float, ticks: int) -> tuple[F32, Bools]:
    """Scaled rewards of the next `ticks` steps (fewer at the rollout's end) plus the discounted value after them.

    Args:
        after: (S, B) value of the observation right after each step.
        unfit: (S, B) where something outside the policy's hands happened after the step.

    Returns:
        worth (S, B), and where nothing unfit or exploded lies within the ticks counted.
    """
    steps = len(r.rewards)
    worth = np.zeros_like(r.rewards)
    fit = np.ones_like(r.terminated)
    for t in range(steps):
        alive = np.ones(r.rewards.shape[1], dtype=bool)
        last = min(t + ticks, steps) - 1
        for k in range(t, last + 1):
            discount = np.float32(gamma ** (k - t))
            worth[t] += alive * np.float32(1.0 - gamma) * discount * r.rewards[k]
            fit[t] &= ~(alive & r.exploded[k])
            alive = alive & ~(r.terminated[k] | r.exploded[k])
            closing = alive & (r.truncated[k] | (k == last))
            worth[t] += closing * discount * np.float32(gamma) * after[k]
            alive = alive & ~closing
            fit[t] &= ~(alive & unfit[k])
    return worth, fit
