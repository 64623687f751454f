"""DiP's transformer blocks for use, not for training: the same numbers as `network.DecoderLayer` with less work.

Query, key and value are one product, attention is torch's fused kernel (for training it is not: its backward pass is
slow), and cross-attention comes with its projections already multiplied into what it attends to (`folded.Memory`).

Shapes: R rows, T tokens of prefix and plan, N plan frames, W width, H heads, M memory tokens, D blocks.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from planner_service.dip.config import DipConfig
from planner_service.dip.network import DecoderLayer, DipNetwork


@dataclass(frozen=True)
class Memory:
    """What every block's cross-attention sees, head by head: column h * M + m is memory token m for head h.

    With q = x Wq + bq, a score is q . k = x . (Wq k) + bq . k, and what is added to x is the sum over h and m of the
    attention times (v Wo): so Wq k, bq . k and v Wo are all a block needs. There are a dozen memory tokens and sixty
    others, so this is a fifth of the work.

    Attributes:
        keys: (D, R, H * M, W) Wq k over the square root of a head's width.
        bias: (D, R, 1, H * M) bq . k, likewise; -1e4 where there is no token.
        values: (D, R, H * M, W) v Wo.
    """

    keys: Tensor
    bias: Tensor
    values: Tensor


class Blocks(Protocol):
    """Runs the blocks."""

    def __call__(self, tokens: Tensor, memory: Memory) -> Tensor:
        """(R, T, W) float32 tokens of prefix and plan -> (R, N, W) float32 of the plan, not yet normalised."""
        ...


@dataclass(frozen=True)
class _Block:
    """Weights of one block, those of the products in the precision they are multiplied in."""

    norms: tuple[nn.LayerNorm, nn.LayerNorm, nn.LayerNorm]
    qkv: tuple[Tensor, Tensor]
    out: tuple[Tensor, Tensor]
    ff1: tuple[Tensor, Tensor]
    ff2: tuple[Tensor, Tensor]
    cross_bias: Tensor


class TorchBlocks:
    """The blocks in torch.

    Args:
        network: whose blocks.
        bf16: multiply in bfloat16; sums, norms and cross-attention stay in float32.
    """

    def __init__(self, network: DipNetwork, bf16: bool = False):
        self._config = network.config
        self._precision = torch.bfloat16 if bf16 else torch.float32
        with torch.no_grad():
            self._blocks = [self._block(layer) for layer in network.layers]

    def __call__(self, tokens: Tensor, memory: Memory) -> Tensor:
        """See `Blocks`."""
        x = tokens
        last = len(self._blocks) - 1
        for number, block in enumerate(self._blocks):
            keep = self._config.plan_frames if number == last else x.shape[1]
            x = _run(block, x, memory, number, keep, self._config, self._precision)
        return x

    def _block(self, layer: nn.Module) -> _Block:
        assert isinstance(layer, DecoderLayer)
        own = layer.self_attention

        def cast(weight: Tensor, bias: Tensor) -> tuple[Tensor, Tensor]:
            return weight.detach().to(self._precision), bias.detach().to(self._precision)

        return _Block(
            norms=(layer.norm1, layer.norm2, layer.norm3),
            qkv=cast(
                torch.cat([own.query.weight, own.key_value.weight]), torch.cat([own.query.bias, own.key_value.bias])
            ),
            out=cast(own.out.weight, own.out.bias),
            ff1=cast(layer.ff1.weight, layer.ff1.bias),
            ff2=cast(layer.ff2.weight, layer.ff2.bias),
            cross_bias=layer.cross_attention.out.bias.detach(),
        )


def _run(
    block: _Block, x: Tensor, memory: Memory, number: int, keep: int, config: DipConfig, precision: torch.dtype
) -> Tensor:
    """One block: (R, T, W) -> its last `keep` tokens (R, keep, W)."""
    first = config.norm_first
    norm1, norm2, norm3 = block.norms
    tail = x[:, -keep:]
    tail = tail + _attend((norm1(x) if first else x).to(precision), block, keep, config.heads)
    if not first:
        tail = norm1(tail)
    tail = tail + _cross(norm2(tail) if first else tail, block, memory, number, config.heads)
    if not first:
        tail = norm2(tail)
    hidden = F.gelu(F.linear((norm3(tail) if first else tail).to(precision), *block.ff1))
    tail = tail + F.linear(hidden, *block.ff2)
    return tail if first else norm3(tail)


def _attend(y: Tensor, block: _Block, keep: int, heads: int) -> Tensor:
    """Self-attention of the last `keep` tokens of y (R, T, W) to all of them -> (R, keep, W)."""
    r, t, w = y.shape
    if keep == t:
        q, k, v = F.linear(y, *block.qkv).view(r, t, 3, heads, w // heads).permute(2, 0, 3, 1, 4)
    else:
        weight, bias = block.qkv
        q = F.linear(y[:, -keep:], weight[:w], bias[:w]).view(r, keep, heads, w // heads).transpose(1, 2)
        k, v = F.linear(y, weight[w:], bias[w:]).view(r, t, 2, heads, w // heads).permute(2, 0, 3, 1, 4)
    out = F.scaled_dot_product_attention(q, k, v)
    return F.linear(out.transpose(1, 2).reshape(r, keep, w), *block.out)


def _cross(y: Tensor, block: _Block, memory: Memory, number: int, heads: int) -> Tensor:
    """Cross-attention of y (R, T, W) -> (R, T, W)."""
    r, t, _ = y.shape
    scores = torch.baddbmm(memory.bias[number], y, memory.keys[number].transpose(1, 2))
    weights = torch.softmax(scores.view(r, t, heads, -1), dim=-1).view(r, t, -1)
    return torch.baddbmm(block.cross_bias, weights, memory.values[number])
