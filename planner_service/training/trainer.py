"""DiP's training loop. Resumes exactly: a checkpoint has model, optimiser, EMA, every generator and the step count."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Generator
from contextlib import closing
from copy import deepcopy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor
from torch.utils.tensorboard import SummaryWriter

from planner_service.dip.config import DipConfig
from planner_service.dip.diffusion import add_noise, cosine_schedule, on_device
from planner_service.dip.features_torch import Normalizer
from planner_service.dip.network import DipNetwork
from planner_service.training.dataset import TextBank, WindowSampler
from planner_service.training.drawing import NumberedWork, Shares, Work, draw, drawn_by_workers
from planner_service.training.losses import LossWeights, dip_loss, feature_weights
from shared.processor import bf16_pays
from shared.training.passes import Pass


class TrainSettings(BaseModel):
    """How to train.

    Attributes:
        decay_until: step at which the learning rate has fallen, in a straight line, to a twentieth; None: it stays.
        text_dropout: share of windows that lose their text, for guidance.
        pooled_alone: share of windows that have nothing of their text but its pooled token: the words of a sentence
            that was never seen are less like those of its likes than the sentence as a whole.
        bf16: run the network under bfloat16 autocast (by default where the processor has it); losses stay in float32.
        keyed_share, velocity_share: for networks that take keyframes or a velocity, shares of the windows with a target
            or a heading that get them.
        keyframe_weight, velocity_weight: of the squared errors of keyed joints (m2) and of the velocity (m2/s2).
        ema_decay: the average's decay is min(ema_decay, (1 + n) / (10 + n)) at step n.
        workers: processes that draw the windows; 0 draws them between the updates.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")
    batch: int = Field(64, gt=0)
    learning_rate: float = Field(4e-4, gt=0)
    warmup_steps: int = Field(200, gt=0)
    decay_until: int | None = Field(None, gt=0)
    weight_decay: float = Field(0.01, ge=0)
    clip_norm: float = Field(1.0, gt=0)
    text_dropout: float = Field(0.1, ge=0, le=1)
    pooled_alone: float = Field(0.3, ge=0, le=1)
    keyed_share: float = Field(0.4, ge=0, le=1)
    velocity_share: float = Field(0.35, ge=0, le=1)
    keyframe_weight: float = Field(LossWeights.keyframe, ge=0)
    velocity_weight: float = Field(LossWeights.desired_velocity, ge=0)
    ema_decay: float = Field(0.9999, gt=0, lt=1)
    bf16: bool = Field(default_factory=bf16_pays)
    seed: int = 0
    log_every: int = Field(20, gt=0)
    save_every: int = Field(250, gt=0)
    workers: int = Field(0, ge=0)


@dataclass
class TrainState:
    """What changes while training and is written to a checkpoint."""

    step: int
    hours: float


class Trainer:
    """Trains one network on windows.

    Args:
        network: starts with these weights.
        normalizer: of the features; fixed.
        sampler, texts: where windows and token features come from.
        settings: how.
        out: folder for `last.pt`, `log.jsonl` and TensorBoard's files.
        device: where the networks are trained, e.g. `cuda`.
    """

    def __init__(
        self,
        network: DipNetwork,
        normalizer: Normalizer,
        sampler: WindowSampler,
        texts: TextBank,
        settings: TrainSettings,
        out: Path,
        device: str = "cpu",
    ):
        self.network, self.normalizer, self.settings, self.out = network, normalizer, settings, out
        self.device = torch.device(device)
        self.network.to(self.device)
        self.average = deepcopy(network).eval().requires_grad_(False)
        self._sampler, self._texts = sampler, texts.to(self.device)
        self._schedule = on_device(cosine_schedule(network.config.steps), self.device)
        self._there = Normalizer(normalizer.mean.to(self.device), normalizer.std.to(self.device))
        self._weights = LossWeights(keyframe=settings.keyframe_weight, desired_velocity=settings.velocity_weight)
        self._group_weights = feature_weights(self._weights).to(self.device)
        self._shares = Shares(
            settings.batch,
            settings.text_dropout,
            settings.pooled_alone,
            settings.keyed_share,
            settings.velocity_share,
        )
        self._optimizer = torch.optim.AdamW(
            network.parameters(), settings.learning_rate, weight_decay=settings.weight_decay, fused=True
        )
        self._pass = Pass(self._losses, network.parameters(), recorded=self.device.type == "cuda")
        self._form: Work
        self._names: list[str] = []
        self._generator = torch.Generator().manual_seed(settings.seed)
        torch.manual_seed(settings.seed)
        self.state = TrainState(0, 0.0)
        out.mkdir(parents=True, exist_ok=True)

    @property
    def config(self) -> DipConfig:
        """Of the network."""
        return self.network.config

    def run(self, until: int, stop: Callable[[], bool], report: Callable[[str], None]) -> None:
        """Train until step `until` or until `stop()`; either way a checkpoint is written at the end."""
        sums: dict[str, Tensor] = {}
        began, since = time.monotonic(), self.state.step
        last = began
        with (
            (self.out / "log.jsonl").open("a", encoding="utf-8") as log,
            SummaryWriter(str(self.out / "tb")) as board,
            closing(self._drawn(until)) as drawn,
        ):
            while self.state.step < until and not stop():
                for name, term in self.update(next(drawn)).items():
                    sums[name] = sums[name] + term if name in sums else term
                now = time.monotonic()
                self.state.hours += (now - last) / 3600
                last = now
                done = self.state.step - since
                if done % self.settings.log_every == 0:
                    means = {k: float(v) / self.settings.log_every for k, v in sums.items()}
                    sums.clear()
                    pace = done / (now - began)
                    row = {"step": self.state.step, "hours": self.state.hours, "steps_per_s": pace, **means}
                    log.write(json.dumps(row) + "\n")
                    log.flush()
                    for name, value in means.items():
                        board.add_scalar(name, value, self.state.step)
                    left = (until - self.state.step) / pace / 3600
                    shown = " ".join(f"{k} {v:.4f}" for k, v in means.items())
                    report(f"step {self.state.step}/{until} {1 / pace:.2f} s/step, {left:.1f} h left | {shown}")
                if self.state.step % self.settings.save_every == 0:
                    self.save(self.out / "last.pt")
        self.save(self.out / "last.pt")
        report(f"stopped at step {self.state.step}; checkpoint in {self.out / 'last.pt'}")

    def train_step(self) -> dict[str, float]:
        """One update on work drawn now; the loss terms."""
        return {name: float(value) for name, value in self.update(next(self._drawn(self.state.step + 1))).items()}

    def _drawn(self, until: int) -> Generator[Work, None, None]:
        """The work of the steps from the present one to before `until`."""
        if self.settings.workers:
            source = NumberedWork(self._sampler, self.config, self._shares, self.settings.seed)
            pinned = self.device.type == "cuda"
            yield from drawn_by_workers(source, self.state.step, until, self.settings.workers, pinned)
            return
        while True:
            yield draw(self._sampler, self.config, self._shares, self._generator)

    def update(self, work: Work) -> dict[str, Tensor]:
        """One update; the loss terms, on the device."""
        settings = self.settings
        work = work.to(self.device)
        work = replace(work, noise=self._noise(work))
        self._form = work
        self.network.train()
        terms = self._pass(*work.tensors())
        for group in self._optimizer.param_groups:
            group["lr"] = learning_rate(settings, self.state.step)
        norm = torch.nn.utils.clip_grad_norm_(self.network.parameters(), settings.clip_norm)
        # One bad batch must not end hours of training; the step is counted and its gradients are dropped.
        if torch.isfinite(norm):
            self._optimizer.step()
        self._update_average()
        self.state.step += 1
        return {**{name: term.clone() for name, term in zip(self._names, terms, strict=True)}, "grad_norm": norm}

    def _losses(self, *tensors: Tensor) -> list[Tensor]:
        """The loss of a work's tensors and its terms, whose names are kept."""
        settings, config = self.settings, self.config
        work = self._form.with_tensors(tensors)
        assert work.noise is not None
        asked = work.asked
        text, text_mask = self._texts.told(work.told)
        clean = self._there.normalize(work.plan)
        noisy = add_noise(self._schedule, clean, work.step, work.noise)
        vector = asked.targets.vector(config.plan_frames)
        keyframes = None if asked.keyframes is None else asked.keyframes.vector()
        velocity = None if asked.velocity is None else asked.velocity.vector()
        # A recording must not read casts that were made before it.
        kept = self.device.type == "cpu"
        with torch.autocast(self.device.type, torch.bfloat16, enabled=settings.bf16, cache_enabled=kept):
            predicted = self.network(
                noisy, work.step, self._there.normalize(work.prefix), vector, text, text_mask, keyframes, velocity
            )
        loss, terms = dip_loss(
            predicted.float(),
            clean,
            work.prefix[:, -1],
            self._there.mean,
            self._there.std,
            asked.targets,
            self._schedule.alpha_bar[work.step],
            self._weights,
            self._group_weights,
            asked.keyframes,
            asked.velocity,
        )
        self._names = ["loss", *terms]
        return [loss, *terms.values()]

    def _noise(self, work: Work) -> Tensor:
        """Noise (B, N, F) of the work, or where it brings none that of this step, drawn by the device."""
        if work.noise is not None:
            return work.noise
        generator = torch.Generator(self.device).manual_seed(self.settings.seed * 1_000_003 + self.state.step)
        return torch.randn(work.plan.shape, generator=generator, device=self.device)

    def _update_average(self) -> None:
        n = self.state.step
        decay = min(self.settings.ema_decay, (1 + n) / (10 + n))
        with torch.no_grad():
            ours: list[Tensor] = list(self.average.parameters())
            torch._foreach_lerp_(ours, [p.detach() for p in self.network.parameters()], 1 - decay)

    def save(self, path: Path) -> None:
        """Write a checkpoint; the old one is there until the new one is complete."""
        content: dict[str, Any] = {
            "config": self.config.model_dump_json(),
            "settings": self.settings.model_dump_json(),
            "step": self.state.step,
            "hours": self.state.hours,
            "network": self.network.state_dict(),
            "average": self.average.state_dict(),
            "optimizer": self._optimizer.state_dict(),
            "mean": self.normalizer.mean,
            "std": self.normalizer.std,
            "sampler": self._sampler.state(),
            "generator": self._generator.get_state(),
            "torch_rng": torch.get_rng_state(),
        }
        if self.device.type == "cuda":
            content["device_rng"] = torch.cuda.get_rng_state(self.device)
        scratch = path.with_suffix(".part")
        torch.save(content, scratch)
        scratch.rename(path)

    def restore(self, content: dict[str, Any]) -> None:
        """Continue exactly from what `read_checkpoint` gave."""
        self.network.load_state_dict(content["network"])
        self.average.load_state_dict(content["average"])
        self._optimizer.load_state_dict(content["optimizer"])
        self._sampler.restore(content["sampler"])
        self._generator.set_state(content["generator"])
        torch.set_rng_state(content["torch_rng"])
        if self.device.type == "cuda" and "device_rng" in content:
            torch.cuda.set_rng_state(content["device_rng"], self.device)
        self.state = TrainState(content["step"], content["hours"])


def learning_rate(settings: TrainSettings, step: int) -> float:
    """Rate of the update after `step` updates: a rise over the warm-up times a fall toward `decay_until`."""
    rise = min(1.0, (step + 1) / settings.warmup_steps)
    fall = 1.0 if settings.decay_until is None else max(0.05, 1.0 - step / settings.decay_until)
    return settings.learning_rate * rise * fall


def read_checkpoint(path: Path) -> dict[str, Any]:
    """Content of a checkpoint; only tensors and plain values are read."""
    content: dict[str, Any] = torch.load(path, weights_only=True, map_location="cpu")
    return content


def checkpoint_normalizer(content: dict[str, Any]) -> Normalizer:
    """The normaliser a checkpoint was trained with."""
    mean: Tensor = content["mean"]
    return Normalizer(mean, content["std"])
