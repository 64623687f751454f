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

    @classmethod
    def empty(cls, steps: int, envs: int, observation: int, action: int) -> Rollout:
        """All zeros."""

        def grid() -> F32:
            return np.zeros((steps, envs), np.float32)

        def flags() -> Bools:
            return np.zeros((steps, envs), bool)

        return cls(
            np.zeros((steps, envs, observation), np.float32), np.zeros((steps, envs, action), np.float32),
            grid(), grid(), grid(), flags(), flags(), flags(), grid(), np.zeros(envs, np.float32),
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
