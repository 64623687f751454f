"""DDPM (Ho et al. 2020) with a cosine schedule (Nichol & Dhariwal 2021) that predicts x0, and its guided sampler.

Few steps, fixed small posterior variance, no noise at the last step (REFERENCE 1).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import torch
from torch import Tensor

Denoiser = Callable[[Tensor, int], Tensor]
"""(noisy (B, N, F), number of the step) -> predicted x0 (B, N, F)."""


@dataclass(frozen=True)
class Schedule:
    """Constants of the diffusion, each (steps,) float32.

    Attributes:
        alpha_bar: share of the signal's variance left at a step.
        x0_weight, xt_weight: posterior mean = x0_weight * x0 + xt_weight * x_t.
        sigma: posterior standard deviation; zero at step 0.
    """

    alpha_bar: Tensor
    x0_weight: Tensor
    xt_weight: Tensor
    sigma: Tensor

    @property
    def steps(self) -> int:
        """How many there are."""
        return int(self.alpha_bar.shape[0])


def cosine_schedule(steps: int, offset: float = 0.008, max_beta: float = 0.999) -> Schedule:
    """The cosine schedule over `steps` steps."""

    def level(t: float) -> float:
        return math.cos((t + offset) / (1 + offset) * math.pi / 2) ** 2

    beta = torch.tensor(
        [min(1 - level((i + 1) / steps) / level(i / steps), max_beta) for i in range(steps)], dtype=torch.float64
    )
    return _schedule(torch.cumprod(1 - beta, dim=0))


def respaced(schedule: Schedule, numbers: Sequence[int]) -> Schedule:
    """The schedule that visits only these of the steps (rising): same noise levels, longer ways between them."""
    return _schedule(schedule.alpha_bar[list(numbers)].double())


def spread_steps(steps: int, count: int) -> list[int]:
    """`count` of the numbers 0 .. steps - 1, evenly, with both ends; the last alone for a count of one."""
    if count == 1:
        return [steps - 1]
    return [round(i * (steps - 1) / (count - 1)) for i in range(count)]


def _schedule(alpha_bar: Tensor) -> Schedule:
    """From float64 levels, falling."""
    before = torch.cat([torch.ones(1, dtype=torch.float64), alpha_bar[:-1]])
    kept = alpha_bar / before
    beta = 1 - kept
    return Schedule(
        alpha_bar=alpha_bar.float(),
        x0_weight=(beta * before.sqrt() / (1 - alpha_bar)).float(),
        xt_weight=((1 - before) * kept.sqrt() / (1 - alpha_bar)).float(),
        sigma=(beta * (1 - before) / (1 - alpha_bar)).sqrt().float(),
    )


def on_device(schedule: Schedule, device: torch.device) -> Schedule:
    """The same constants on a device."""
    return Schedule(**{field.name: getattr(schedule, field.name).to(device) for field in fields(Schedule)})


def add_noise(schedule: Schedule, x0: Tensor, step: Tensor, noise: Tensor) -> Tensor:
    """x_t (B, N, F) of clean x0 at steps (B,)."""
    a = schedule.alpha_bar[step][:, None, None]
    return a.sqrt() * x0 + (1 - a).sqrt() * noise


def sample(schedule: Schedule, denoise: Denoiser, noise: Tensor, begun: Tensor | None = None, done: int = 0) -> Tensor:
    """Ancestral sampling.

    Args:
        schedule: the diffusion's constants.
        denoise: the (guided) network, told the number of the step within this schedule.
        noise: (steps, B, N, F) standard normal: row 0 is x_T, row i the noise added after the i-th network call.
        begun: (B, N, F) what `sample_some` had come to after the first `done` network calls; from there it goes on.

    Returns:
        (B, N, F) the last x0.
    """
    return _sampled(schedule, denoise, noise, begun, done, schedule.steps)[0]


def sample_some(
    schedule: Schedule, denoise: Denoiser, noise: Tensor, until: int, begun: Tensor | None = None, done: int = 0
) -> tuple[Tensor, Tensor]:
    """The network calls of `sample` up to so many: (B, N, F) the x0 foreseen by then, and what to go on from."""
    return _sampled(schedule, denoise, noise, begun, done, until)


def _sampled(
    schedule: Schedule, denoise: Denoiser, noise: Tensor, begun: Tensor | None, done: int, until: int
) -> tuple[Tensor, Tensor]:
    x = x0 = noise[0] if begun is None else begun
    for i in range(done, until):
        number = schedule.steps - 1 - i
        x0 = denoise(x, number)
        if number == 0:
            return x0, x0
        x = schedule.x0_weight[number] * x0 + schedule.xt_weight[number] * x + schedule.sigma[number] * noise[i + 1]
    return x0, x
