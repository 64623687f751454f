"""The PPO trainer: collects, updates, evaluates, logs, and resumes exactly from its last checkpoint."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch.utils.tensorboard import SummaryWriter

from shared.protocol.rates import TICK_HZ
from tracker_service.simulation.humanoid import Humanoid
from tracker_service.training.dataset import ReferenceSet
from tracker_service.training.env import TrackingEnv
from tracker_service.training.env_settings import EnvSettings
from tracker_service.training.evaluate import evaluate
from tracker_service.training.network import ActorCritic, Normalizer, log_prob
from tracker_service.training.ppo import PpoSettings, PpoUpdater, to_numpy
from tracker_service.training.storage import Rollout

F32 = npt.NDArray[np.float32]
AVERAGED_ITERATIONS = 100


class Trainer:
    """See the module's docstring.

    Args:
        human, train_set, heldout_set: what is trained on and judged by.
        out: folder of checkpoint, log and TensorBoard files.
        env_settings, ppo_settings: numbers.
        seed: of everything random.
    """

    def __init__(
        self, human: Humanoid, train_set: ReferenceSet, heldout_set: ReferenceSet, out: Path,
        env_settings: EnvSettings, ppo_settings: PpoSettings, seed: int,
    ):  # fmt: skip
        torch.manual_seed(seed)
        self.human, self.heldout, self.out = human, heldout_set, out
        self.env = TrackingEnv(human, train_set, env_settings, seed)
        self.ppo_settings = ppo_settings
        size = self.env.observation_size
        self.network = ActorCritic(size, self.env.hinges)
        self.normalizer = Normalizer(size)
        self.averaged = deepcopy(self.network.actor)
        self.updater = PpoUpdater(self.network, ppo_settings)
        self.rng = np.random.default_rng(seed + 1)
        self.samples = 0
        self.iteration = 0
        self.seconds = 0.0
        self.observation: F32 = self.env.reset_all()
        out.mkdir(parents=True, exist_ok=True)
        self.writer = SummaryWriter(str(out / "tensorboard"))

    def train(
        self, until_samples: int, should_stop: Callable[[], bool], say: Callable[[str], None],
        checkpoint_s: float = 120.0, evaluate_every: int = 1_000_000,
    ) -> None:  # fmt: skip
        """Go on to `until_samples` or until told to stop; a checkpoint is written either way."""
        saved = time.monotonic()
        while self.samples < until_samples and not should_stop():
            started = time.monotonic()
            before = self.samples
            stats = self.iterate()
            self.seconds += time.monotonic() - started
            if self.iteration % 30 == 0:
                self._log({"kind": "train", **stats}, say)
            if before // evaluate_every != self.samples // evaluate_every:
                self._log({"kind": "heldout", **self.judge()}, say)
                self.save(self.out / "checkpoint.pt")
            if time.monotonic() - saved > checkpoint_s:
                self.save(self.out / "checkpoint.pt")
                saved = time.monotonic()
        self.save(self.out / "checkpoint.pt")

    def iterate(self) -> dict[str, float]:
        """One rollout and one update."""
        started = time.monotonic()
        rollout, normalized, facts = self._collect()
        collected = time.monotonic()
        facts |= self.updater.update(rollout, normalized, self.rng)
        # The policy of a rollout sees one normaliser throughout; it learns from the rollout afterwards.
        self.normalizer.update(rollout.observations.reshape(-1, rollout.observations.shape[-1]))
        self.iteration += 1
        self._average()
        facts["collect_s"] = collected - started
        facts["update_s"] = time.monotonic() - collected
        return facts

    @torch.no_grad()
    def _collect(self) -> tuple[Rollout, torch.Tensor, dict[str, float]]:
        s, env, net = self.ppo_settings, self.env, self.network
        r = Rollout.empty(s.steps, env.settings.envs, env.observation_size, env.hinges)
        spread = net.spread()
        deviation = to_numpy(spread.exp())
        errors = []
        noise = self.rng.standard_normal((s.steps, env.settings.envs, env.hinges), dtype=np.float32)
        for t in range(s.steps):
            x = self.normalizer(torch.from_numpy(self.observation))
            mean = net.actor(x)
            action = to_numpy(mean) + deviation * noise[t]
            r.observations[t], r.actions[t] = self.observation, action
            r.log_probs[t] = to_numpy(log_prob(mean, spread, torch.from_numpy(action)))
            r.values[t] = to_numpy(net.value(x))
            result = env.step(action)
            r.rewards[t], r.terminated[t] = result.reward, result.terminated
            r.truncated[t], r.exploded[t] = result.truncated, result.exploded
            r.truncated_values[t] = np.where(result.truncated, self._values(result.final_observation), 0.0)
            errors.append(float(result.error_m.mean()))
            self.observation = result.observation
        r.last_values = self._values(self.observation)
        self.samples += s.steps * env.settings.envs
        ended = int(r.terminated.sum() + r.truncated.sum())
        facts = {
            "reward": float(r.rewards.mean()),
            "episode_s": float(r.rewards.size / max(ended, 1) / TICK_HZ),
            "error_m": float(np.mean(errors)),
            "survived": float(r.truncated.sum() / max(ended, 1)),
            "exploded": float(r.exploded.sum()),
            "fail_rate": float(np.average(env.failures.by_clip(), weights=env.references.weight)),
        }
        normalized = self.normalizer(torch.from_numpy(r.observations.reshape(-1, env.observation_size)))
        return r, normalized, facts

    def _values(self, observation: F32) -> F32:
        """(B,) values of raw observations (B, D)."""
        return to_numpy(self.network.value(self.normalizer(torch.from_numpy(observation))))

    @torch.no_grad()
    def _average(self) -> None:
        """Polyak averaging: each update carries noise that the mean of the last hundred does not."""
        share = 1.0 / min(self.iteration, AVERAGED_ITERATIONS)
        for mean, now in zip(self.averaged.parameters(), self.network.actor.parameters(), strict=True):
            mean.lerp_(now, share)

    @torch.no_grad()
    def act_averaged(self, observation: F32) -> F32:
        """The averaged policy without exploration: the one that is judged and shipped."""
        return to_numpy(self.averaged(self.normalizer(torch.from_numpy(observation))))

    @torch.no_grad()
    def act(self, observation: F32) -> F32:
        """The policy without exploration."""
        return to_numpy(self.network.actor(self.normalizer(torch.from_numpy(observation))))

    def judge(self) -> dict[str, Any]:
        """Held-out clips with the averaged policy; without the list of clips."""
        result = evaluate(self.env.settings, self.heldout, self.human, self.act_averaged)
        del result["per_clip"]
        return result

    def _log(self, facts: dict[str, Any], say: Callable[[str], None]) -> None:
        row = {"samples": self.samples, "seconds": round(self.seconds, 1), **facts}
        with (self.out / "log.jsonl").open("a", encoding="utf-8") as log:
            log.write(json.dumps(row) + "\n")
        for name, value in facts.items():
            if isinstance(value, float):
                self.writer.add_scalar(f"{facts['kind']}/{name}", value, self.samples)
        numbers = {k: v for k, v in facts.items() if isinstance(v, (int, float))}
        say(f"{self.samples / 1e6:7.3f}M {self.seconds / 60:6.1f}min {facts['kind']}: " + " ".join(
            f"{k}={v:.4g}" for k, v in numbers.items()
        ))  # fmt: skip
        if "by_behaviour" in facts:
            say("    " + " ".join(f"{k}={v['success']:.2f}/{v['clips']}" for k, v in facts["by_behaviour"].items()))

    def save(self, path: Path) -> None:
        """Everything needed to go on as if never stopped: tensors, plain numbers and JSON only."""
        env = self.env
        state = {
            "network": self.network.state_dict(),
            "averaged": self.averaged.state_dict(),
            "normalizer": self.normalizer.state_dict(),
            "optimizer": self.updater.optimizer.state_dict(),
            "learning_rate": self.updater.learning_rate,
            "counters": [self.samples, self.iteration, self.seconds],
            "rng": json.dumps([self.rng.bit_generator.state, env.rng.bit_generator.state]),
            "clip_names": [str(name) for name in env.references.names],
            "env": {
                name: torch.from_numpy(np.array(getattr(env, name)))
                for name in ("state", "clip", "time", "age", "jump_m", "previous_action", "begun")
            },
            "failures": torch.from_numpy(env.failures.rate.copy()),
            "failure_visits": torch.from_numpy(env.failures.visits.copy()),
            "kin_failures": torch.from_numpy(env.failures.kin_rate.copy()),
            "observation": torch.from_numpy(self.observation.copy()),
        }
        partial = path.with_suffix(".partial")
        torch.save(state, partial)
        partial.replace(path)

    def load(self, path: Path, weights_only: bool = False) -> None:
        """Go on from a checkpoint; with other clips or another number of environments, these begin anew.

        With `weights_only` the optimiser and its rate begin anew too.
        """
        state = torch.load(path, weights_only=True)
        self.network.load_state_dict(state["network"])
        self.averaged.load_state_dict(state.get("averaged") or self.network.actor.state_dict())
        self.normalizer.load_state_dict(state["normalizer"])
        self.samples, self.iteration, self.seconds = state["counters"]
        if not weights_only:
            # A fresh Adam steps by its full rate along every sign: one such update moved most ratios out of the clip.
            self.updater.optimizer.load_state_dict(state["optimizer"])
            self.updater.learning_rate = state["learning_rate"]
        env = self.env
        same = state["clip_names"] == [str(name) for name in env.references.names]
        if weights_only or not same or len(state["env"]["clip"]) != env.settings.envs:
            self.observation = env.reset_all()
            return
        env.failures.rate[:] = state["failures"].numpy()
        env.failures.visits[:] = state["failure_visits"].numpy()
        env.failures.kin_rate[:] = state["kin_failures"].numpy()
        self.rng.bit_generator.state, env.rng.bit_generator.state = json.loads(state["rng"])
        for name, value in state["env"].items():
            setattr(env, name, value.numpy().copy())
        env.moved()
        self.observation = state["observation"].numpy().copy()
