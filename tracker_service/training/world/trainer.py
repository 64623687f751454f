"""Training through the world model: collect, fit, imagine; evaluate, log, and resume exactly.

A checkpoint holds networks, optimisers, generators, environments and failure rates; the replay ring lies beside it.
Where the ring is not there (another machine), it is filled again by the policy, and what that did to the model's loss
is said.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch.utils.tensorboard import SummaryWriter

from shared.errors import InvalidInputError
from shared.protocol.rates import TICK_HZ
from tracker_service.simulation.humanoid import Humanoid
from tracker_service.training.dataset import ReferenceSet
from tracker_service.training.env import TrackingEnv
from tracker_service.training.env_settings import EnvSettings
from tracker_service.training.evaluate import evaluate
from tracker_service.training.processes import ProcessEnv
from tracker_service.training.sampling import KIN_SECONDS
from tracker_service.training.seats import HEIGHTS
from tracker_service.training.world.learner import Learner
from tracker_service.training.world.quality import drift_mm, response_cosine
from tracker_service.training.world.replay import Replay
from tracker_service.training.world.settings import WorldSettings

F32 = npt.NDArray[np.float32]
FIRST_ROWS = 120
"""Rows of the ring that are filled before the first update."""
FIRST_MODEL_UPDATES = 200
FIRST_CRITIC_UPDATES = 200
_ENV_ARRAYS = ("state", "clip", "time", "begun", "age", "jump_m", "previous_action")
_RING_ARRAYS = (
    "qpos", "qvel", "target", "previous_action", "observation", "jump_m", "reward", "clip", "time", "cut", "terminated",
)  # fmt: skip


class WorldTrainer:
    """See the module's docstring.

    Args:
        human, train_set, heldout_set: what is trained on and judged by.
        out: folder of checkpoint, log and TensorBoard files.
        env_settings, settings: numbers. seed: of everything random. device: where the networks are.
    """

    def __init__(
        self, human: Humanoid, train_set: ReferenceSet, heldout_set: ReferenceSet, out: Path,
        env_settings: EnvSettings, settings: WorldSettings, seed: int, device: str = "cpu",
    ):  # fmt: skip
        torch.manual_seed(seed)
        self.human, self.heldout, self.out, self.settings = human, heldout_set, out, settings
        spread = env_settings.processes > 1
        self._judged_as = env_settings  # `ProcessEnv` keeps its own with one thread
        self.env = (ProcessEnv if spread else TrackingEnv)(human, train_set, env_settings, seed)
        heights = HEIGHTS if env_settings.heights else 0
        self.learner = Learner(human, train_set, env_settings, settings, self.env.observation_size, heights, device)
        size, hinges = self.env.observation_size, self.env.hinges
        self.replay = Replay(settings.buffer_ticks, env_settings.envs, size, hinges, device)
        self.rng = np.random.default_rng(seed + 1)
        self.samples = self.iteration = 0
        self.seconds = 0.0
        self.ready = False
        """Whether the ring holds enough for updates."""
        self.observation: F32 = self.env.reset_all()
        # Some environments show what the policy does by itself, others how it recovers.
        self._noise = np.resize([0.0, 0.5, 1.0, 2.0], env_settings.envs).astype(np.float32)[:, None] * settings.spread
        out.mkdir(parents=True, exist_ok=True)
        self.writer = SummaryWriter(str(out / "tensorboard"))

    def collect(self, ticks: int) -> dict[str, float]:
        """Ticks of all environments into the ring."""
        env, ring = self.env, self.replay
        ended = survived = exploded = 0
        errors = []
        for _ in range(ticks):
            ring.put(qpos=env.qpos, qvel=env.qvel, clip=env.clip, time=env.time, jump_m=env.jump_m)
            ring.put(observation=self.observation, previous_action=env.previous_action)
            mean = self.learner.act(self.observation)
            action = mean + self._noise * self.rng.standard_normal(mean.shape, dtype=np.float32)
            ring.put(target=env.targets(action))
            result = env.step(action)
            failed = result.terminated | result.exploded
            cut = failed | result.truncated
            cut[result.disturbed] = True
            ring.put(reward=result.reward, cut=cut, terminated=failed)
            ring.forward()
            self.observation = result.observation
            self.samples += env.settings.envs
            survived += int(result.truncated.sum())
            ended += int((failed | result.truncated).sum())
            exploded += int(result.exploded.sum())
            errors.append(float(result.error_m.mean()))
        return {
            "survived": survived / max(ended, 1),
            "episode_s": ticks * env.settings.envs / max(ended, 1) / TICK_HZ,
            "error_m": float(np.mean(errors)),
            "exploded": float(exploded),
        }

    def prepare(self, say: Callable[[str], None], fresh_sight: bool, fresh_model: bool) -> None:
        """Fill the ring, and bring the model and the critic up to what is in it."""
        self.collect(FIRST_ROWS)
        self.learner.take_normalisation(self.replay, self.rng, fresh_sight, fresh_model)
        for name, count, update in (
            ("model", FIRST_MODEL_UPDATES, self.learner.update_model),
            ("critic", FIRST_CRITIC_UPDATES, self.learner.update_critic),
        ):
            losses = [facts[f"{name}_loss"] for _ in range(count) if (facts := update(self.replay, self.rng))]
            tenth = max(len(losses) // 10, 1)
            say(f"ring filled anew: loss of the {name} {np.mean(losses[:tenth]):.3f} -> {np.mean(losses[-tenth:]):.3f}")
        self.ready = True

    def iterate(self) -> dict[str, float]:
        """One iteration: collect, fit, imagine; facts and seconds of each."""
        s, learner = self.settings, self.learner
        clock = [time.monotonic()]
        facts = self.collect(s.collect_ticks)
        clock.append(time.monotonic())
        for _ in range(s.model_updates):
            facts |= learner.update_model(self.replay, self.rng)
        clock.append(time.monotonic())
        for _ in range(s.critic_updates):
            facts |= learner.update_critic(self.replay, self.rng)
        clock.append(time.monotonic())
        for _ in range(s.policy_updates):
            facts |= learner.update_policy(self.replay, self.rng)
        clock.append(time.monotonic())
        names = ("collect_s", "model_s", "critic_s", "policy_s")
        facts |= {name: b - a for name, a, b in zip(names, clock[:-1], clock[1:], strict=True)}
        self.iteration += 1
        return facts

    def train(
        self, until_samples: int, stopped: Callable[[], bool], say: Callable[[str], None],
        judge_every_s: float = 900.0, save_every_s: float = 300.0, log_every: int = 50,
    ) -> None:  # fmt: skip
        """Iterate until enough samples, or until `stopped`; then save."""
        judged = saved = last = time.monotonic()
        rows: list[dict[str, float]] = []
        if not self.ready:
            self.prepare(say, fresh_sight=self.iteration == 0, fresh_model=self.iteration == 0)
        while self.samples < until_samples and not stopped():
            rows.append(self.iterate())
            now = time.monotonic()
            self.seconds += now - last
            last = now
            if len(rows) >= log_every:
                self._log({"kind": "train", **_means(rows)}, say)
                rows = []
            if now - saved > save_every_s:
                self.save(self.out / "checkpoint.pt")
                saved = time.monotonic()
            if now - judged > judge_every_s:
                self._log({"kind": "heldout", **self.judge()}, say)
                judged = last = time.monotonic()
        self.save(self.out / "checkpoint.pt")
        self._log({"kind": "heldout", **self.judge()}, say)
        self.writer.close()
        self.env.close()

    def judge(self) -> dict[str, Any]:
        """Held-out clips with the averaged policy, without the list of clips, and the quality of the model."""
        result = evaluate(self._judged_as, self.heldout, self.human, lambda o: self.learner.act(o, averaged=True))
        del result["per_clip"]
        result |= drift_mm(self.learner, self.replay, self._judging_rng())
        return result | response_cosine(self.learner, self.env, self.replay, self._judging_rng())

    def _judging_rng(self) -> np.random.Generator:
        """Judging draws nothing from the generator of training: when it happens must not change what is learnt."""
        return np.random.default_rng(self.iteration)

    def _log(self, facts: dict[str, Any], say: Callable[[str], None]) -> None:
        row = {"samples": self.samples, "iteration": self.iteration, "seconds": round(self.seconds, 1), **facts}
        with (self.out / "log.jsonl").open("a", encoding="utf-8") as log:
            log.write(json.dumps(row) + "\n")
        numbers = {k: v for k, v in facts.items() if isinstance(v, (int, float))}
        for name, value in numbers.items():
            self.writer.add_scalar(f"{facts['kind']}/{name}", value, self.samples)
        head = f"{self.samples / 1e6:7.3f}M {self.seconds / 60:6.1f}min {facts['kind']}: "
        say(head + " ".join(f"{k}={v:.3g}" for k, v in numbers.items()))
        if "by_behaviour" in facts:
            say("    " + " ".join(f"{k}={v['success']:.2f}/{v['clips']}" for k, v in facts["by_behaviour"].items()))

    def save(self, path: Path) -> None:
        """Everything needed to go on as if never stopped; the ring goes to `replay.npz` beside it."""
        learner, env, ring = self.learner, self.env, self.replay
        state = {
            "modules": {name: module.state_dict() for name, module in learner.modules().items()},
            "optimizers": {name: optimizer.state_dict() for name, optimizer in learner.optimizers.items()},
            "counters": [self.samples, self.iteration, self.seconds, learner.policy_updates],
            "rng": json.dumps([self.rng.bit_generator.state, env.rng.bit_generator.state]),
            "clip_names": [str(name) for name in env.references.names],
            "env": {name: torch.from_numpy(np.array(getattr(env, name))) for name in _ENV_ARRAYS},
            "failures": torch.from_numpy(env.failures.rate.copy()),
            "failure_visits": torch.from_numpy(env.failures.visits.copy()),
            "kin": [str(name) for name in env.failures.kin_names],
            "kin_failures": torch.from_numpy(env.failures.kin_rate.copy()),
            "failure_bins": torch.from_numpy(env.failures.bins.copy()),
            "observation": torch.from_numpy(self.observation.copy()),
        }
        ring_path, partial = path.with_name("replay.npz"), path.with_name("replay.partial.npz")
        arrays: dict[str, Any] = {name: _numpy(getattr(ring, name)) for name in _RING_ARRAYS}
        np.savez(partial, iteration=self.iteration, place=np.array([ring.head, ring.filled]), **arrays)
        torch.save(state, path.with_suffix(".partial"))
        partial.replace(ring_path)
        path.with_suffix(".partial").replace(path)

    def load(self, path: Path, say: Callable[[str], None] = print) -> None:
        """Go on from a checkpoint. With other clips or environments these and the ring begin anew; failure rates of
        clips that are still there are kept."""
        # To the processor: networks and optimisers take what is theirs to where they are, Adam's counts stay here.
        state = torch.load(path, weights_only=True, map_location="cpu")
        for name, module in self.learner.modules().items():
            module.load_state_dict(state["modules"][name])
        for name, optimizer in self.learner.optimizers.items():
            rates = [group["lr"] for group in optimizer.param_groups]
            optimizer.load_state_dict(state["optimizers"][name])
            for group, rate in zip(optimizer.param_groups, rates, strict=True):
                group["lr"] = rate  # the settings of this run decide
        self.samples, self.iteration, self.seconds, self.learner.policy_updates = state["counters"]
        self._take_failures(state)
        env = self.env
        same = state["clip_names"] == [str(name) for name in env.references.names]
        if not same or len(state["env"]["clip"]) != env.settings.envs:
            say("other clips or environments than the checkpoint's: episodes begin anew")
            self.observation = env.reset_all()
            return
        for name in _ENV_ARRAYS:
            setattr(env, name, state["env"][name].numpy().copy())
        self.rng.bit_generator.state, env.rng.bit_generator.state = json.loads(state["rng"])
        env.moved()
        self.observation = state["observation"].numpy().copy()
        self._take_ring(path.with_name("replay.npz"), say)

    def _take_failures(self, state: dict[str, Any]) -> None:
        table = self.env.failures
        both = torch.stack([state["failures"], state.get("failure_visits", 0.0 * state["failures"])]).numpy()
        old: dict[str, npt.NDArray[np.float64]] = {}
        first = 0
        for name, bins in zip(state["clip_names"], state["failure_bins"].tolist(), strict=True):
            old[name] = both[:, first : first + bins]
            first += bins
        for clip, name in enumerate(self.env.references.names):
            known = old.get(str(name))
            if known is not None and known.shape[1] == table.bins[clip]:
                here = slice(table.first[clip], table.first[clip] + table.bins[clip])
                table.rate[here], table.visits[here] = known
        kin_rates = state.get("kin_failures", torch.zeros(0)).view(-1, KIN_SECONDS).numpy()
        kin = dict(zip(state.get("kin", []), kin_rates, strict=True))
        rates = table.kin_rate.reshape(-1, KIN_SECONDS)
        for place, name in enumerate(table.kin_names):
            rates[place] = kin.get(str(name), rates[place])

    def _take_ring(self, path: Path, say: Callable[[str], None]) -> None:
        ring = self.replay
        try:
            with np.load(path, allow_pickle=False) as data:
                if int(data["iteration"]) != self.iteration or data["clip"].shape != ring.clip.shape:
                    say("the replay ring beside the checkpoint belongs to another one: filled anew")
                    return
                for name in _RING_ARRAYS:
                    kept = getattr(ring, name)
                    kept[:] = torch.from_numpy(data[name]) if isinstance(kept, torch.Tensor) else data[name]
                ring.head, ring.filled = (int(v) for v in data["place"])
        except FileNotFoundError:
            say("no replay ring beside the checkpoint: filled anew")
            return
        except (OSError, ValueError) as error:
            raise InvalidInputError(f"{path.name} cannot be read: {error}", field="out") from error
        self.ready = True


def _numpy(kept: torch.Tensor | npt.NDArray[np.generic]) -> npt.NDArray[np.generic]:
    return np.asarray(kept.cpu().numpy() if isinstance(kept, torch.Tensor) else kept)


def _means(rows: list[dict[str, float]]) -> dict[str, float]:
    names = {name for row in rows for name in row}
    return {name: float(np.mean([row[name] for row in rows if name in row])) for name in sorted(names)}
