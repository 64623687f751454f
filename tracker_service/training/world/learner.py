"""The three updates: the model on windows of what happened, the critic on returns, the policy on imagined ticks."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from shared.processor import bf16_pays
from shared.training.passes import Pass
from tracker_service.policy.observations import PREVIEW_TICKS
from tracker_service.simulation.humanoid import Humanoid
from tracker_service.training.dataset import ReferenceSet
from tracker_service.training.env import slack_of
from tracker_service.training.env_settings import EnvSettings
from tracker_service.training.network import mlp
from tracker_service.training.world.body import Bodies, Kinematics, Mirror, State, tensor
from tracker_service.training.world.imagination import Imagination, Sight, can_compile, mixed
from tracker_service.training.world.model import WorldModel, model_loss
from tracker_service.training.world.replay import Places, Replay, Spots
from tracker_service.training.world.settings import WorldSettings
from tracker_service.training.world.sight import Reference, observe, still_tracked, support_heights, trembling

F32 = npt.NDArray[np.float32]
MODEL_GRADIENT_NORM = 5.0
TARGET_CRITIC_SHARE = 0.01
SATURATION_COST = 0.002
TAIL_TICKS = max(PREVIEW_TICKS) + 1


def has_bf16(device: torch.device) -> bool:
    """Whether matrix products in bfloat16 pay: as the processor says, see `bf16_pays`. A graphics card spends its time
    on starting kernels, and conversions are more of these: TF32 there."""
    return device.type == "cpu" and bf16_pays()


def with_history(state: State) -> State:
    """The same state as later imagined ones are, contiguous and with gradient: one compiled tick does for all."""
    return State(*(part.contiguous().requires_grad_() for part in state.parts()))


@dataclass(frozen=True)
class References:
    """A `ReferenceSet` as tensors; see there."""

    pos_w_m: Tensor
    linvel_w_mps: Tensor
    rot_xy: Tensor
    qpos: Tensor
    qvel: Tensor
    start: Tensor
    length: Tensor
    seat: Tensor
    slack: Tensor

    @classmethod
    def of(cls, s: ReferenceSet, device: torch.device | str) -> References:
        """On the device."""
        pos, vel, rot, qpos, qvel = (tensor(a, device) for a in (s.pos_w_m, s.linvel_w_mps, s.rot_xy, s.qpos, s.qvel))
        start, length = (torch.from_numpy(a).to(device) for a in (s.start, s.length))
        slack = tensor(slack_of(s.behaviours), device)
        return cls(pos, vel, rot, qpos, qvel, start, length, tensor(s.seat, device), slack)

    def at(self, clip: Tensor, time: Tensor, jump_m: Tensor, decay: float) -> Reference:
        """What is previewed at a tick (B,) of clips (B,), displaced by jumps (B, 2) that decay from now on."""
        last = self.length[clip] - 1

        def frame(ahead: int) -> Tensor:
            return self.start[clip] + torch.minimum(time + ahead, last)

        near, far = PREVIEW_TICKS
        one, later = frame(near), frame(far)
        shift = torch.cat([jump_m, torch.zeros_like(jump_m[:, :1])], -1)[:, None]
        return Reference(
            pos_w_m=self.pos_w_m[one] + shift * decay**near,
            later_pos_w_m=self.pos_w_m[later] + shift * decay**far,
            linvel_w_mps=self.linvel_w_mps[one],
            rot_xy=self.rot_xy[one],
            qvel=self.qvel[one],
            hinge_rad=self.qpos[one, 7:],
            after_rad=self.qpos[frame(2), 7:],
            later_rad=self.qpos[later, 7:],
        )


class Learner:
    """Networks, their optimisers and their updates.

    Args:
        heights: how many support heights the observation ends with (zeros on a flat floor).
    """

    def __init__(
        self, human: Humanoid, references: ReferenceSet, env: EnvSettings, settings: WorldSettings,
        observation: int, heights: int, device: torch.device | str = "cpu",
    ):  # fmt: skip
        s, hinges, bodies = settings, len(human.hinges), len(human.skeleton)
        device = torch.device(device)
        if device.type == "cuda":
            torch.set_float32_matmul_precision("high")
        self.settings, self.env, self.device, self.heights = s, env, device, heights
        self.references = References.of(references, device)
        self.kinematics = Kinematics(human, device)
        self.mirror = Mirror(human, device)
        self.sight = Sight(observation).to(device)
        self.actor = mlp([observation, *s.hidden, hinges], 0.01).to(device)
        self.critic = mlp([observation, *s.hidden, 1], 0.05).to(device)
        self._feet = (human.skeleton.index("left_foot"), human.skeleton.index("right_foot"))
        self.model = WorldModel(bodies, hinges, heights, s.model_hidden).to(device)
        self.averaged = deepcopy(self.actor)
        self.target_critic = deepcopy(self.critic)
        self.bf16 = has_bf16(device) if s.bf16 is None else s.bf16
        self.recorded = device.type == "cuda" if s.recorded is None else s.recorded
        self.compiled = (can_compile(device) and not self.recorded) if s.compiled is None else s.compiled
        self.imagination = Imagination(
            human, env, self.kinematics, self.sight, self.actor, self.model, self.bf16, self.compiled, device
        )
        self.optimizers = {
            "actor": torch.optim.Adam(self.actor.parameters(), lr=s.policy_rate, eps=1e-5),
            "critic": torch.optim.Adam(self.critic.parameters(), lr=s.critic_rate),
            "model": torch.optim.Adam(self.model.parameters(), lr=s.model_rate, eps=1e-6),
        }
        self._passes = {
            "actor": Pass(self._policy_pass, self.actor.parameters(), self.recorded),
            "critic": Pass(self._critic_pass, self.critic.parameters(), self.recorded),
            "model": Pass(self._model_pass, self.model.parameters(), self.recorded),
        }
        self.policy_updates = 0

    def modules(self) -> dict[str, nn.Module]:
        """Everything with weights, by name."""
        return {
            "actor": self.actor, "averaged": self.averaged, "critic": self.critic, "target_critic": self.target_critic,
            "model": self.model, "sight": self.sight,
        }  # fmt: skip

    @torch.no_grad()
    def act(self, observation: F32, averaged: bool = False) -> F32:
        """(B, H) actions without exploration."""
        net = self.averaged if averaged else self.actor
        out: Tensor = net(self.sight(torch.from_numpy(observation).to(self.device)))
        return np.asarray(out.cpu().numpy(), dtype=np.float32)

    def value(self, observation: Tensor, target: bool = False) -> Tensor:
        """(B,) worth of raw observations (B, D)."""
        net = self.target_critic if target else self.critic
        return mixed(net, self.sight(observation), self.bf16).squeeze(-1)

    def _tensor(self, array: npt.NDArray[np.generic]) -> Tensor:
        return torch.from_numpy(np.ascontiguousarray(array)).to(self.device)

    def spots(self, places: Places) -> Spots:
        """The same places for tensors of the ring."""
        return Spots.of(places, self.device)

    def state_at(self, replay: Replay, index: tuple[Tensor, Tensor]) -> State:
        """States (N,) at places of the ring."""
        return State.of(replay.qpos[index], replay.qvel[index])

    def seats_at(self, replay: Replay, places: Places) -> Tensor:
        """(N, 5) seats of the clips that are followed at places of the ring."""
        return self.references.seat[self._tensor(replay.clip[places.later(0)])]

    def heights_of(self, bodies: Bodies, seat: Tensor) -> Tensor:
        """(B, K) what is underfoot; without gradient, for it is flat but for its edges."""
        if not self.heights:
            return bodies.pos_w_m.new_zeros(len(seat), 0)
        return support_heights(bodies, seat, self._feet)

    @torch.no_grad()
    def take_normalisation(self, replay: Replay, rng: np.random.Generator, sight: bool, model: bool) -> None:
        """Spread of observations, and of the model's features and changes, from what is in the ring."""
        places = replay.draw(rng, 8192, 1)
        at = self.spots(places)
        if model:
            s, n = self.state_at(replay, at.later(0)), self.state_at(replay, at.later(1))
            target = replay.target[at.later(0)]
            bodies = self.kinematics(s)
            seat = self.seats_at(replay, places)
            self.model.normalize_by(s, bodies, target, self.heights_of(bodies, seat), n)
        if sight:
            seen = replay.observation[at.later(0)]
            self.sight.mean.copy_(seen.mean(0))
            self.sight.std.copy_(seen.std(0).clamp(min=0.02))

    def update_model(self, replay: Replay, rng: np.random.Generator) -> dict[str, float]:
        """One step on windows of the ring, some of them in the mirror."""
        s = self.settings
        places = replay.draw(rng, s.model_batch, s.model_ticks)
        count = len(places.slot)
        if count < s.model_batch:  # a compiled or recorded update knows one batch size
            return {}
        which = torch.from_numpy(rng.random(count) < s.mirrored_share).to(self.device)
        window = self.spots(places).window(s.model_ticks + 1)
        loss, first, drift = self._passes["model"](
            replay.qpos[window], replay.qvel[window], replay.target[window], self.seats_at(replay, places), which
        )
        self._step("model", self.model, MODEL_GRADIENT_NORM)
        return {"model_loss": float(loss), "model_one_tick": float(first), "model_drift_mm": 1e3 * float(drift)}

    def _model_pass(
        self, qpos: Tensor, qvel: Tensor, target: Tensor, seat: Tensor, which: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Loss of the model over windows (T + 1, B, ...), mirrored where `which` (B,); error after one tick, in units
        of the hinges' usual change, and the root's after all."""
        ticks = self.settings.model_ticks
        state = self.mirror.some(State.of(qpos[0], qvel[0]), which)
        if self.compiled:
            state = with_history(state)
        bodies = self.kinematics(state)
        seat = self.mirror.some_seats(seat, which)
        loss = torch.zeros((), device=self.device)
        for k in range(ticks):
            wanted = self.mirror.some_hinges(target[k], which)
            state, bodies = self.imagination.model_tick(state, bodies, wanted, self.heights_of(bodies, seat))
            true = self.mirror.some(State.of(qpos[k + 1], qvel[k + 1]), which)
            loss = loss + model_loss(self.model, state, true)
            if k == 0:
                scale = self.model.scale[6 : 6 + self.model.hinges]
                first = ((state.rate_radps - true.rate_radps) / scale).abs().mean()
        return loss / ticks, first, (state.pos_w_m - true.pos_w_m).norm(dim=-1).mean()

    def update_critic(self, replay: Replay, rng: np.random.Generator) -> dict[str, float]:
        """One step on n-step returns, bootstrapped by the slowly moving target critic."""
        s = self.settings
        places, total, after, factor = replay.returns(rng, s.critic_batch, s.critic_ticks, s.gamma)
        with torch.no_grad():
            rest = self.value(replay.observation[self.spots(after).later(0)], target=True)
            wanted = self._tensor(total) + self._tensor(factor) * rest
        (loss,) = self._passes["critic"](replay.observation[self.spots(places).later(0)], wanted)
        self._step("critic", self.critic, None)
        with torch.no_grad():
            for slow, now in zip(self.target_critic.parameters(), self.critic.parameters(), strict=True):
                slow.lerp_(now, TARGET_CRITIC_SHARE)
        explained = 1.0 - float(loss) / (float(wanted.var()) + 1e-8)
        return {"critic_loss": float(loss), "critic_explained": explained}

    def _critic_pass(self, observation: Tensor, wanted: Tensor) -> tuple[Tensor]:
        return (((self.value(observation) - wanted) ** 2).mean(),)

    def update_policy(self, replay: Replay, rng: np.random.Generator) -> dict[str, float]:
        """One step up the gradient of imagined reward and the critic's value where imagination ends."""
        s = self.settings
        # What follows is imagined: where a bag or a push came next one can start too.
        places: Places = replay.draw(rng, s.policy_batch, 0, s.recent_ticks)
        if len(places.slot) < s.policy_batch:
            return {}
        index = places.later(0)
        at = self.spots(places).later(0)
        _, worth, error, alive, power = self._passes["actor"](
            replay.qpos[at], replay.qvel[at], self._tensor(replay.clip[index]), self._tensor(replay.time[index]),
            replay.jump_m[at], replay.previous_action[at].float(),
        )  # fmt: skip
        norm = self._step("actor", self.actor, s.policy_gradient_norm)
        self.policy_updates += 1
        self._average()
        return {
            "imagined_worth": float(worth), "imagined_error_m": float(error), "imagined_alive": float(alive),
            "policy_gradient": norm, "power_kw": float(power),
        }  # fmt: skip

    def _policy_pass(
        self, qpos: Tensor, qvel: Tensor, clip: Tensor, time: Tensor, jump: Tensor, previous: Tensor
    ) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """Loss of imagined ticks from states (B, ...); their worth, the last one's distance, the share that is still
        tracked, and the mean power in kW."""
        s, env = self.settings, self.env
        for module in (self.model, self.critic):
            module.requires_grad_(False)
        seat, slack = self.references.seat[clip], self.references.slack[clip]
        state = State.of(qpos, qvel)
        if self.compiled:
            state = with_history(state)
        bodies = self.kinematics(state)
        total = torch.zeros(len(clip), device=self.device)
        alive = torch.ones_like(total)
        beyond = torch.zeros((), device=self.device)
        power = torch.zeros((), device=self.device)
        for k in range(s.horizon):
            ref = self.references.at(clip, time + k, jump * env.jump_decay**k, env.jump_decay)
            seen = self.imagination.tick(state, bodies, ref, self.heights_of(bodies, seat))
            action = seen.action.clamp(-1.0, 1.0)
            reward = seen.reward - s.smoothness * ((action - previous) ** 2).mean(-1) - s.power * seen.power_kw
            if s.calm > 0:
                reward = reward - s.calm * trembling(bodies, seen.bodies, ref.linvel_w_mps)
            state, bodies = seen.state, seen.bodies
            previous = action
            total = total + alive * (1.0 - s.gamma) * s.gamma**k * reward
            beyond = beyond + ((seen.action.abs() - 1.0).clamp(min=0) ** 2).sum(-1).mean()
            power = power + seen.power_kw.detach().mean()
            alive = alive * still_tracked(seen.distance_m.detach(), env.stop_mean_m, env.stop_max_m, slack)
        ref = self.references.at(clip, time + s.horizon, jump * env.jump_decay**s.horizon, env.jump_decay)
        last = observe(state, bodies, ref, self.heights_of(bodies, seat))
        total = total + alive * s.gamma**s.horizon * self.value(last)
        # A clip's last ticks, where the preview stands still, are never simulated: the critic knows nothing of them.
        inside = (time + s.horizon < self.references.length[clip] - TAIL_TICKS).float()
        worth = (total * inside).sum() / inside.sum().clamp(min=1.0)
        for module in (self.model, self.critic):
            module.requires_grad_(True)
        loss = -worth + SATURATION_COST * beyond / s.horizon
        return loss, worth, seen.distance_m.mean(), alive.mean(), power / s.horizon

    def _step(self, name: str, module: nn.Module, norm: float | None) -> float:
        """A step down the gradients that a pass has left; their size."""
        size = float(nn.utils.clip_grad_norm_(module.parameters(), norm if norm is not None else float("inf")))
        # One batch of exploded imagination must not end up in Adam's moments.
        if np.isfinite(size):
            self.optimizers[name].step()
        return size

    @torch.no_grad()
    def _average(self) -> None:
        keep = min(self.settings.averaging, (1 + self.policy_updates) / (10 + self.policy_updates))
        for mean, now in zip(self.averaged.parameters(), self.actor.parameters(), strict=True):
            mean.lerp_(now, 1.0 - keep)
