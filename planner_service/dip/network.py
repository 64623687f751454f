"""DiP's transformer decoder: prefix and noisy frames in, clean plan frames out (REFERENCE 1).

Shapes: B batch, P prefix frames, N plan frames, F features, L text tokens, W width.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from planner_service.dip.conditions import KEYFRAME_NUMBERS, TARGET_NUMBERS, VELOCITY_NUMBERS
from planner_service.dip.config import EXTRA_CONDITIONS, DipConfig
from shared.errors import InvalidInputError


def sinusoid(positions: Tensor, width: int) -> Tensor:
    """Sinusoidal embedding (..., width) of numbers (...), as in Vaswani et al. (2017)."""
    half = width // 2
    frequency = torch.exp(torch.arange(half, device=positions.device) * (-math.log(10_000.0) / half))
    angle = positions[..., None].float() * frequency
    return torch.cat([torch.sin(angle), torch.cos(angle)], dim=-1)


class Attention(nn.Module):
    """Multi-head attention.

    Written out: for 60 tokens on a CPU the fused kernel's backward pass takes six times as long
    (docs/experiments_planner.md). Plans are made by `folded.FoldedDip`, which uses the kernel.
    """

    def __init__(self, width: int, heads: int):
        super().__init__()
        self.heads = heads
        self.query = nn.Linear(width, width)
        self.key_value = nn.Linear(width, 2 * width)
        self.out = nn.Linear(width, width)

    def forward(self, x: Tensor, memory: Tensor, mask: Tensor | None) -> Tensor:
        """x (B, Q, W) attends to memory (B, K, W); mask (B, 1, 1, K) True where attended -> (B, Q, W)."""
        b, q, w = x.shape
        k = memory.shape[1]
        depth = w // self.heads
        queries = (self.query(x) * depth**-0.5).view(b, q, self.heads, depth).transpose(1, 2)
        keys, values = self.key_value(memory).view(b, k, 2, self.heads, depth).permute(2, 0, 3, 1, 4)
        scores = queries @ keys.transpose(-1, -2)
        if mask is not None:
            scores = scores.masked_fill(~mask, -1e4)
        out = torch.softmax(scores, dim=-1).to(values.dtype) @ values
        return self.out(out.transpose(1, 2).reshape(b, q, w))


class SharedDropout(nn.Module):
    """Dropout whose mask is one a sequence, not one a token: drawing a mask a token takes a quarter of a CPU step."""

    def __init__(self, probability: float):
        super().__init__()
        self.probability = probability

    def forward(self, x: Tensor) -> Tensor:
        """x (B, T, W) with whole channels of a sequence zeroed, in training only."""
        if not self.training or self.probability == 0.0:
            return x
        keep = 1.0 - self.probability
        mask = torch.empty(x.shape[0], 1, x.shape[2], dtype=x.dtype, device=x.device).bernoulli_(keep) / keep
        return x * mask


class DecoderLayer(nn.Module):
    """Self-attention, cross-attention and feed-forward, each with a residual and a norm before or after it."""

    def __init__(self, config: DipConfig):
        super().__init__()
        w = config.width
        self.norm_first = config.norm_first
        self.self_attention = Attention(w, config.heads)
        self.cross_attention = Attention(w, config.heads)
        self.ff1, self.ff2 = nn.Linear(w, config.ff), nn.Linear(config.ff, w)
        self.norm1, self.norm2, self.norm3 = nn.LayerNorm(w), nn.LayerNorm(w), nn.LayerNorm(w)
        self.drop = SharedDropout(config.dropout)

    def forward(self, x: Tensor, memory: Tensor, mask: Tensor, keep: int) -> Tensor:
        """x (B, T, W), memory (B, M, W), mask (B, 1, 1, M) -> the last `keep` tokens (B, keep, W)."""
        tail = x[:, -keep:]
        if self.norm_first:
            y = self.norm1(x)
            tail = tail + self.drop(self.self_attention(y[:, -keep:], y, None))
            tail = tail + self.drop(self.cross_attention(self.norm2(tail), memory, mask))
            return tail + self.drop(self._ff(self.norm3(tail)))
        tail = self.norm1(tail + self.drop(self.self_attention(tail, x, None)))
        tail = self.norm2(tail + self.drop(self.cross_attention(tail, memory, mask)))
        return self.norm3(tail + self.drop(self._ff(tail)))

    def _ff(self, x: Tensor) -> Tensor:
        return self.ff2(self.drop(F.gelu(self.ff1(x))))


class DipNetwork(nn.Module):
    """Predicts the clean plan x0 from its noisy version, the prefix and the conditions. All features normalised."""

    def __init__(self, config: DipConfig):
        super().__init__()
        self.config = config
        w = config.width
        self.frame_in = nn.Linear(config.features, w)
        self.time_mlp = nn.Sequential(nn.Linear(w, w), nn.SiLU(), nn.Linear(w, w))
        self.target_mlp = nn.Sequential(nn.Linear(TARGET_NUMBERS, w), nn.SiLU(), nn.Linear(w, w))
        # They start at zero and have no bias: what is not asked for, or not yet learnt, changes nothing.
        if config.keyframes:
            self.keyframe_in = _zero_linear(KEYFRAME_NUMBERS, w)
        if config.velocity:
            self.velocity_in = _zero_linear(VELOCITY_NUMBERS, w)
        self.text_in = nn.Linear(config.text_dim, w)
        self.text_mean: Tensor
        self.text_whitening: Tensor
        if config.pooled_text:
            self.register_buffer("text_mean", torch.zeros(config.text_dim))
            self.register_buffer("text_whitening", torch.eye(config.text_dim, config.pooled_text))
            self.text_pool = nn.Sequential(nn.Linear(config.pooled_text, w), nn.SiLU(), nn.Linear(w, w))
        self.layers = nn.ModuleList(DecoderLayer(config) for _ in range(config.layers))
        self.norm_out = nn.LayerNorm(w) if config.norm_first else nn.Identity()
        self.frame_out = nn.Linear(w, config.features)
        places = torch.arange(config.prefix_frames + config.plan_frames)
        self.place: Tensor
        self.step_embedding: Tensor
        self.register_buffer("place", sinusoid(places, w), persistent=False)
        self.register_buffer("step_embedding", sinusoid(torch.arange(config.steps), w), persistent=False)

    def forward(
        self,
        noisy: Tensor,
        step: Tensor,
        prefix: Tensor,
        targets: Tensor,
        text: Tensor,
        text_mask: Tensor,
        keyframes: Tensor | None = None,
        velocity: Tensor | None = None,
    ) -> Tensor:
        """One denoising step.

        Args:
            noisy: (B, N, F) plan at diffusion step `step`.
            step: (B,) int64, 0 (almost clean) .. steps - 1 (almost noise).
            prefix: (B, P, F) clean frames before the plan.
            targets: (B, TARGET_NUMBERS) from `conditions.TargetBatch.vector`.
            text: (B, L, text_dim) token features, the pooled one first.
            text_mask: (B, L) True where a token counts, all False for no text.
            keyframes: (B, N, KEYFRAME_NUMBERS) from `conditions.KeyframeBatch.vector`; none, or for weights that do
                not take them, None.
            velocity: (B, VELOCITY_NUMBERS) from `conditions.VelocityBatch.vector`; as above.

        Returns:
            (B, N, F) predicted clean plan.
        """
        condition = self.time_mlp(self.step_embedding[step]) + self.target_mlp(targets)
        if velocity is not None:
            condition = condition + self.velocity_in(velocity)
        if self.config.pooled_text:
            pooled = (text[:, 0] - self.text_mean) @ self.text_whitening
            condition = condition + self.text_pool(pooled) * text_mask[:, :1]
        memory = torch.cat([condition[:, None], self.text_in(text)], dim=1)
        mask = torch.cat([torch.ones_like(text_mask[:, :1]), text_mask], dim=1)[:, None, None, :]
        x = self.frame_in(torch.cat([prefix, noisy], dim=1)) + self.place
        if self.config.condition_every_frame:
            prefix_tokens, plan_tokens = x[:, : self.config.prefix_frames], x[:, self.config.prefix_frames :]
            x = torch.cat([prefix_tokens, plan_tokens + condition[:, None]], dim=1)
        if keyframes is not None:
            prefix_tokens, plan_tokens = x[:, : self.config.prefix_frames], x[:, self.config.prefix_frames :]
            x = torch.cat([prefix_tokens, plan_tokens + self.keyframe_in(keyframes)], dim=1)
        last = len(self.layers) - 1
        for number, layer in enumerate(self.layers):
            keep = self.config.plan_frames if number == last else x.shape[1]
            x = layer(x, memory, mask, keep)
        # Eight bits of mantissa in the output would be half a millimetre of noise a frame.
        with torch.autocast(x.device.type, enabled=False):
            return self.frame_out(self.norm_out(x.float()))


def _zero_linear(inputs: int, outputs: int) -> nn.Linear:
    layer = nn.Linear(inputs, outputs, bias=False)
    nn.init.zeros_(layer.weight)
    return layer


def with_conditions(network: DipNetwork, names: Iterable[str]) -> DipNetwork:
    """A copy that takes these of EXTRA_CONDITIONS, too; until it is trained it gives what the network gives.

    Raises InvalidInputError for another name.
    """
    wanted = set(names)
    for name in sorted(wanted - set(EXTRA_CONDITIONS)):
        raise InvalidInputError(
            f"no condition {name!r} can be added", field="conditions", allowed=", ".join(EXTRA_CONDITIONS)
        )
    out = DipNetwork(network.config.model_copy(update=dict.fromkeys(wanted, True)))
    out.load_state_dict({**out.state_dict(), **network.state_dict()})
    return out.train(network.training)


def whiten_text(network: DipNetwork, pooled: Tensor, damping: float = 0.1) -> None:
    """Fit the network's fixed whitening of pooled tokens to those of the training sentences (S, text_dim).

    `damping`, as a share of the largest spread, keeps directions that hardly vary from being blown up.
    """
    mean = pooled.mean(0)
    _, spread, directions = torch.linalg.svd(pooled - mean, full_matrices=False)
    spread = spread / len(pooled) ** 0.5
    scale = 1.0 / (spread + damping * spread[0])
    columns = (directions * scale[:, None])[: network.config.pooled_text].T
    network.text_mean.copy_(mean)
    network.text_whitening.zero_()
    network.text_whitening[:, : columns.shape[1]] = columns


def parameter_count(model: nn.Module) -> int:
    """Trainable numbers in a model."""
    return sum(p.numel() for p in model.parameters() if p.requires_grad)
