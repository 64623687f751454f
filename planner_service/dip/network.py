"""DiP's transformer decoder: prefix and noisy frames in, clean plan frames out (REFERENCE 1).

Shapes: B batch, P prefix frames, N plan frames, F features, L text tokens, W width.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812 - torch's own customary name

from planner_service.dip.conditions import TARGET_NUMBERS
from planner_service.dip.config import DipConfig


def sinusoid(positions: Tensor, width: int) -> Tensor:
    """Sinusoidal embedding (..., width) of numbers (...), as in Vaswani et al. (2017)."""
    half = width // 2
    frequency = torch.exp(torch.arange(half, device=positions.device) * (-math.log(10_000.0) / half))
    angle = positions[..., None].float() * frequency
    return torch.cat([torch.sin(angle), torch.cos(angle)], dim=-1)


class Attention(nn.Module):
    """Multi-head attention.

    Written out: for 60 tokens on a CPU the fused kernel's backward pass takes six times as long (docs/experiments_planner.md).
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
        return self.out(out.transpose(1, 2).reshape(b, q, w))  # type: ignore[no-any-return]


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
        return self.norm3(tail + self.drop(self._ff(tail)))  # type: ignore[no-any-return]

    def _ff(self, x: Tensor) -> Tensor:
        return self.ff2(self.drop(F.gelu(self.ff1(x))))  # type: ignore[no-any-return]


class DipNetwork(nn.Module):
    """Predicts the clean plan x0 from its noisy version, the prefix and the conditions. All features normalised."""

    def __init__(self, config: DipConfig):
        super().__init__()
        self.config = config
        w = config.width
        self.frame_in = nn.Linear(config.features, w)
        self.time_mlp = nn.Sequential(nn.Linear(w, w), nn.SiLU(), nn.Linear(w, w))
        self.target_mlp = nn.Sequential(nn.Linear(TARGET_NUMBERS, w), nn.SiLU(), nn.Linear(w, w))
        self.text_in = nn.Linear(config.text_dim, w)
        self.layers = nn.ModuleList(DecoderLayer(config) for _ in range(config.layers))
        self.norm_out = nn.LayerNorm(w) if config.norm_first else nn.Identity()
        self.frame_out = nn.Linear(w, config.features)
        places = torch.arange(config.prefix_frames + config.plan_frames)
        self.register_buffer("place", sinusoid(places, w), persistent=False)
        self.register_buffer("step_embedding", sinusoid(torch.arange(config.steps), w), persistent=False)

    def forward(
        self, noisy: Tensor, step: Tensor, prefix: Tensor, targets: Tensor, text: Tensor, text_mask: Tensor
    ) -> Tensor:
        """One denoising step.

        Args:
            noisy: (B, N, F) plan at diffusion step `step`.
            step: (B,) int64, 0 (almost clean) .. steps - 1 (almost noise).
            prefix: (B, P, F) clean frames before the plan.
            targets: (B, TARGET_NUMBERS) from `conditions.TargetBatch.vector`.
            text: (B, L, text_dim) token features; text_mask: (B, L) True where a token counts, all False for no text.

        Returns:
            (B, N, F) predicted clean plan.
        """
        condition = self.time_mlp(self.step_embedding[step]) + self.target_mlp(targets)
        memory = torch.cat([condition[:, None], self.text_in(text)], dim=1)
        mask = torch.cat([torch.ones_like(text_mask[:, :1]), text_mask], dim=1)[:, None, None, :]
        x = self.frame_in(torch.cat([prefix, noisy], dim=1)) + self.place
        if self.config.condition_every_frame:
            x = torch.cat([x[:, : self.config.prefix_frames], x[:, self.config.prefix_frames :] + condition[:, None]], 1)
        last = len(self.layers) - 1
        for number, layer in enumerate(self.layers):
            keep = self.config.plan_frames if number == last else x.shape[1]
            x = layer(x, memory, mask, keep)
        return self.frame_out(self.norm_out(x))  # type: ignore[no-any-return]


def parameter_count(model: nn.Module) -> int:
    """Trainable numbers in a model."""
    return sum(p.numel() for p in model.parameters() if p.requires_grad)
