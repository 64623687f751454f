"""What a training step works on: windows, what they ask for, diffusion steps and noise, drawn by the CPU.

With workers, the work of step n is drawn from generators seeded by (seed, n): whichever process draws it, and whether
training was stopped before it or not, it is the same.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, TypeVar

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from planner_service.dip.config import DipConfig
from planner_service.training.asking import Asked, sample_asked
from planner_service.training.dataset import Told, WindowSampler

T = TypeVar("T")


@dataclass(frozen=True)
class Shares:
    """How B windows are made: how many, and which shares of them lose their text, have nothing of it but the pooled
    token, get keyframes and get a velocity."""

    batch: int
    text_dropout: float
    pooled_alone: float
    keyed: float
    velocity: float


@dataclass(frozen=True)
class Work:
    """B windows of a training step.

    Attributes:
        prefix (B, P, F), plan (B, N, F): not normalised. asked: what the network is told of the plan.
        told: of which sentences, and how.
        step: (B,) int64 diffusion step. noise: (B, N, F); None where the device draws it.
    """

    prefix: Tensor
    plan: Tensor
    asked: Asked
    told: Told
    step: Tensor
    noise: Tensor | None

    def to(self, device: torch.device) -> Work:
        """The same on another device."""
        return _mapped(self, lambda tensor: tensor.to(device, non_blocking=True))

    def tensors(self) -> list[Tensor]:
        """All tensors, in one order."""
        found: list[Tensor] = []

        def keep(tensor: Tensor) -> Tensor:
            found.append(tensor)
            return tensor

        _mapped(self, keep)
        return found

    def with_tensors(self, tensors: Sequence[Tensor]) -> Work:
        """The same with others in the place of `tensors()`."""
        rest = iter(tensors)
        return _mapped(self, lambda _: next(rest))

    def pin_memory(self) -> Work:
        """The same in memory that a GPU copies from beside its own work."""
        return _mapped(self, lambda tensor: tensor.contiguous().pin_memory())


def draw(
    sampler: WindowSampler, config: DipConfig, shares: Shares, generator: torch.Generator, with_noise: bool = True
) -> Work:
    """The next work, from the sampler's generator and `generator`."""
    batch = sampler.draw(shares.batch)
    keep = sampler.rng.random(shares.batch) >= shares.text_dropout
    prefix, plan = batch.features[:, : config.prefix_frames], batch.features[:, config.prefix_frames :]
    asked = sample_asked(plan, config, shares.keyed, shares.velocity, generator)
    # A bent path is explained by what is asked for, never by the sentence alone.
    keep &= batch.shown & (asked.any().numpy() | ~batch.bent)
    told = Told(
        torch.from_numpy(batch.sentence),
        torch.from_numpy(batch.other),
        torch.from_numpy(sampler.rng.random(shares.batch, dtype=np.float32)),
        torch.from_numpy(sampler.rng.random(shares.batch) < shares.pooled_alone),
        torch.from_numpy(np.asarray(keep)),
    )
    step = torch.randint(0, config.steps, (shares.batch,), generator=generator)
    noise = torch.randn(plan.shape, generator=generator) if with_noise else None
    return Work(prefix, plan, asked, told, step, noise)


class NumberedWork(Dataset[Work]):
    """The work of step n, by n; without noise, which the device draws."""

    def __init__(self, sampler: WindowSampler, config: DipConfig, shares: Shares, seed: int):
        self._sampler, self._config, self._shares, self._seed = sampler, config, shares, seed

    def __getitem__(self, number: int) -> Work:
        self._sampler.restart([self._seed, number])
        seed = int(np.random.SeedSequence([self._seed, number, 1]).generate_state(1, np.uint64)[0] >> 1)
        return draw(self._sampler, self._config, self._shares, torch.Generator().manual_seed(seed), with_noise=False)


def drawn_by_workers(
    source: NumberedWork, first: int, until: int, workers: int, pinned: bool
) -> Generator[Work, None, None]:
    """The work of steps `first` to `until` - 1 in order, drawn by processes that share the corpus' memory."""
    loader: DataLoader[Work] = DataLoader(
        source, batch_size=None, sampler=range(first, until), num_workers=workers, prefetch_factor=4,
        pin_memory=pinned, multiprocessing_context="fork", worker_init_fn=_settle,
        generator=torch.Generator(),  # else the loader draws a seed that nothing uses from the one of the dropout
    )  # fmt: skip
    drawn = iter(loader)
    try:
        yield from drawn
    finally:  # workers do not hear the SIGTERM that would end them at exit, and a traceback keeps the loader
        drawn._shutdown_workers()  # type: ignore[attr-defined]


def _settle(worker: int) -> None:
    """One thread; and what ends the training (Ctrl-C reaches all processes) is the training's to hear."""
    torch.set_num_threads(1)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)


def _mapped(value: T, change: Callable[[Tensor], Tensor]) -> T:
    """A dataclass with all tensors in it, however deep, changed."""
    made: dict[str, Any] = {}
    for field in fields(value):  # type: ignore[arg-type]
        part = getattr(value, field.name)
        if isinstance(part, Tensor):
            made[field.name] = change(part)
        elif is_dataclass(part):
            made[field.name] = _mapped(part, change)
    return replace(value, **made)  # type: ignore[type-var]
