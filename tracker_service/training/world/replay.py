"""A ring of what the humanoids did: whole ticks of all environments, from which windows are drawn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

F32 = npt.NDArray[np.float32]
Ints = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Places:
    """Positions in the ring: slot (N,) and environment (N,), and how many ticks the ring holds."""

    slot: Ints
    env: Ints
    capacity: int

    def later(self, ticks: int | Ints) -> tuple[Ints, Ints]:
        """Index of the places some ticks later."""
        return (self.slot + ticks) % self.capacity, self.env


@dataclass(frozen=True)
class Spots:
    """`Places` as tensors where the networks are: copied there once, for each copy waits for all work before it."""

    slot: Tensor
    env: Tensor
    capacity: int

    @classmethod
    def of(cls, places: Places, device: torch.device | str) -> Spots:
        """Of places, on a device."""
        return cls(torch.from_numpy(places.slot).to(device), torch.from_numpy(places.env).to(device), places.capacity)

    def later(self, ticks: int) -> tuple[Tensor, Tensor]:
        """Index of the places some ticks later."""
        return (self.slot + ticks) % self.capacity, self.env

    def window(self, ticks: int) -> tuple[Tensor, Tensor]:
        """Index (T, N) of the places and of the T - 1 ticks after them."""
        ahead = torch.arange(ticks, device=self.slot.device)[:, None]
        return (self.slot + ahead) % self.capacity, self.env.expand(ticks, -1)


class Replay:
    """The last `capacity` ticks of B environments; D observation size, H hinges.

    What the networks read is where they are, on `device`; what places are drawn by stays with the processor.

    Attributes:
        qpos, qvel, target, previous_action, observation, jump_m: before the tick, tensors. reward: the tick's.
        clip, time: what was followed.
        cut: whether the next row does not follow from this one. terminated: whether the episode failed in this tick.
    """

    def __init__(self, capacity: int, envs: int, observation: int, hinges: int, device: torch.device | str = "cpu"):
        self.capacity, self.envs = capacity, envs
        shape = (capacity, envs)

        def kept(size: int, dtype: torch.dtype = torch.float32) -> Tensor:
            return torch.zeros((*shape, size), dtype=dtype, device=device)

        self.qpos, self.qvel = kept(7 + hinges), kept(6 + hinges)
        self.target, self.previous_action = kept(hinges), kept(hinges, torch.float16)
        self.observation, self.jump_m = kept(observation), kept(2)
        self.reward = np.zeros(shape, np.float32)
        self.clip = np.zeros(shape, np.int64)
        self.time = np.zeros(shape, np.int64)
        self.cut = np.ones(shape, bool)
        self.terminated = np.zeros(shape, bool)
        self.head = 0
        self.filled = 0

    def put(self, **rows: npt.NDArray[np.generic]) -> None:
        """Values (B, ...) of the row at `head`, by the names of the attributes."""
        for name, values in rows.items():
            kept = getattr(self, name)
            kept[self.head] = torch.from_numpy(values) if isinstance(kept, Tensor) else values

    def forward(self) -> None:
        """The row at `head` is complete; go on to the next."""
        self.head = (self.head + 1) % self.capacity
        self.filled = min(self.filled + 1, self.capacity)

    def draw(self, rng: np.random.Generator, count: int, ticks: int, recent: int | None = None) -> Places:
        """`count` places (fewer where little fits) that `ticks` ticks follow without a cut.

        Args:
            recent: only from the last so many rows.
        """
        span = self.filled if recent is None else min(self.filled, recent)
        slot = (self.head - rng.integers(ticks + 1, max(span + 1, ticks + 2), size=2 * count)) % self.capacity
        env = rng.integers(0, self.envs, size=2 * count)
        whole = np.ones(2 * count, dtype=bool)
        for k in range(ticks):
            whole &= ~self.cut[(slot + k) % self.capacity, env]
        return Places(slot[whole][:count], env[whole][:count], self.capacity)

    def returns(
        self, rng: np.random.Generator, count: int, ticks: int, gamma: float
    ) -> tuple[Places, F32, Places, F32]:
        """Discounted rewards over `ticks` ticks, or until the episode ends.

        Returns:
            places; (N,) sum of (1 - gamma) gamma^k r_k; places to bootstrap from; (N,) factor of the value there, 0
            where the episode failed.
        """
        slot = (self.head - rng.integers(ticks + 1, max(self.filled + 1, ticks + 2), size=count)) % self.capacity
        env = rng.integers(0, self.envs, size=count)
        total = np.zeros(count, np.float32)
        after = np.full(count, ticks)
        factor = np.full(count, gamma**ticks)
        alive = np.ones(count, dtype=bool)
        for k in range(ticks):
            at = (slot + k) % self.capacity
            failed, cut = self.terminated[at, env], self.cut[at, env]
            # Truncation and disturbance are not failure: the value of the state before them stands for the rest.
            paused = alive & cut & ~failed
            after[paused], factor[paused] = k, gamma**k
            going = alive & ~paused
            total += going * np.float32((1.0 - gamma) * gamma**k) * self.reward[at, env]
            factor[alive & failed] = 0.0
            alive &= ~cut
        first = Places(slot, env, self.capacity)
        return first, total, Places((slot + after) % self.capacity, env, self.capacity), factor.astype(np.float32)
