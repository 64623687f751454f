"""The PPO update (Schulman et al. 2017) with a learning rate that holds the KL divergence near a target.

It is what learning through a world model is compared with (`tracker_service.training.world`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor

from tracker_service.training.network import ActorCritic, log_prob, run_mixed
from tracker_service.training.storage import Rollout, advantages, valid


class PpoSettings(BaseModel):
    """Numbers of PPO. `kl_target` steers the learning rate; `bound_weight` keeps means of actions within +-1;
    `bf16` runs hidden layers of the update in bfloat16."""

    model_config = ConfigDict(frozen=True)
    steps: int = Field(default=8, gt=0)
    gamma: float = 0.97
    lam: float = 0.8
    clip: float = 0.25
    epochs: int = 3
    minibatches: int = 2
    learning_rate: float = 3e-4
    learning_rate_range: tuple[float, float] = (5e-6, 1e-3)
    critic_rate: float = 1e-3
    kl_target: float = 0.02
    value_weight: float = 1.0
    bound_weight: float = 0.05
    entropy_weight: float = 0.0
    max_grad_norm: float = 1.0
    bf16: bool = True


class PpoUpdater:
    """Owns the optimiser; `update` improves the network on one rollout."""

    def __init__(self, network: ActorCritic, settings: PpoSettings):
        self.network = network
        self.settings = settings
        self.learning_rate = settings.learning_rate
        # The critic has its own, fixed rate: the KL divergence says nothing about it.
        groups: list[dict[str, Any]] = [
            {"params": [*network.actor.parameters(), network.log_std]},
            {"params": list(network.critic.parameters()), "lr": settings.critic_rate},
        ]
        self.optimizer = torch.optim.Adam(groups, lr=self.learning_rate, eps=1e-5)

    def update(self, r: Rollout, normalized: Tensor, rng: np.random.Generator) -> dict[str, float]:
        """One rollout's epochs.

        Args:
            normalized: (S * B, D) its observations as the policy saw them.
            rng: shuffles the minibatches.

        Returns:
            means of the losses, KL divergence, share of clipped ratios, learning rate.
        """
        s = self.settings
        scale = 1.0 - s.gamma  # values stay near [0, 1]
        scaled = Rollout(**{**vars(r), "rewards": r.rewards * np.float32(scale)})
        advantage = advantages(scaled, s.gamma, s.lam)
        returns = torch.from_numpy((advantage + r.values).reshape(-1))
        keep = np.flatnonzero(valid(r).reshape(-1))
        flat = advantage.reshape(-1)
        adv = torch.from_numpy((flat - flat[keep].mean()) / (flat[keep].std() + 1e-8))
        actions = torch.from_numpy(r.actions.reshape(-1, r.actions.shape[-1]))
        old = torch.from_numpy(r.log_probs.reshape(-1))
        totals: dict[str, list[float]] = {"policy": [], "value": [], "kl": [], "clipped": []}
        for _ in range(s.epochs):
            for rows in np.array_split(rng.permutation(keep), s.minibatches):
                self._minibatch(torch.from_numpy(rows), normalized, actions, old, adv, returns, totals)
        explained = 1.0 - float((returns - torch.from_numpy(r.values.reshape(-1))).var() / (returns.var() + 1e-8))
        return {name: float(np.mean(v)) for name, v in totals.items()} | {
            "learning_rate": self.learning_rate,
            "explained_variance": explained,
            "spread": float(self.network.spread().detach().exp().mean()),
        }

    def _minibatch(
        self, rows: Tensor, x: Tensor, actions: Tensor, old: Tensor, adv: Tensor, returns: Tensor,
        totals: dict[str, list[float]],
    ) -> None:  # fmt: skip
        s, net = self.settings, self.network
        batch = x[rows]
        mean = run_mixed(net.actor, batch, s.bf16)
        spread = net.spread()
        logs = log_prob(mean, spread, actions[rows])
        shift = logs - old[rows]
        ratio = shift.exp()
        a = adv[rows]
        policy = -torch.min(ratio * a, torch.clamp(ratio, 1 - s.clip, 1 + s.clip) * a).mean()
        value = ((run_mixed(net.critic, batch, s.bf16).squeeze(-1) - returns[rows]) ** 2).mean()
        bound = (torch.clamp(mean.abs() - 1.0, min=0.0) ** 2).sum(-1).mean()
        loss = policy + s.value_weight * value + s.bound_weight * bound - s.entropy_weight * spread.sum()
        with torch.no_grad():
            kl = float((ratio - 1 - shift).mean())
        self._steer(kl)
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(net.parameters(), s.max_grad_norm)
        self.optimizer.step()
        totals["policy"].append(float(policy.detach()))
        totals["value"].append(float(value.detach()))
        totals["kl"].append(kl)
        totals["clipped"].append(float(((ratio - 1).abs() > s.clip).float().mean()))

    def _steer(self, kl: float) -> None:
        low, high = self.settings.learning_rate_range
        if kl > 2.0 * self.settings.kl_target:
            self.learning_rate = max(low, self.learning_rate / 1.2)
        elif kl < 0.5 * self.settings.kl_target:
            self.learning_rate = min(high, self.learning_rate * 1.2)
        self.optimizer.param_groups[0]["lr"] = self.learning_rate


def to_numpy(x: Tensor) -> npt.NDArray[np.float32]:
    """Detached float32 array."""
    return x.detach().cpu().numpy()
