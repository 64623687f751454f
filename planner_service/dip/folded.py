"""DiP for use: what does not change from step to step is computed once a plan.

Per plan: prefix, text, targets, keyframes and velocity in the blocks' width, and the cross-attention's keys and values
of all text tokens and of the condition at every step. Per step: noisy frames in, the blocks, clean frames out.
The outputs are those of `DipNetwork` but for rounding (tests/planner/test_dip_folded.py).

Shapes: B requests, R rows of the network, S steps; others as in `blocks`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import torch
from torch import Tensor
from torch.nn import functional as F

from planner_service.dip.blocks import Blocks, Memory
from planner_service.dip.network import DecoderLayer, DipNetwork

NO_TOKEN = -1e4
"""Score of what is not attended to."""
MEMORY_MULTIPLE = 8
"""Memory is padded to a multiple of so many tokens: few shapes for backends that prepare each."""


@dataclass(frozen=True)
class Conditions:
    """Inputs of B plans, as for `DipNetwork.forward`, all features normalised.

    Attributes:
        prefix: (B, P, F); targets: (B, TARGET_NUMBERS); text: (B, L, text_dim); text_mask: (B, L).
        keyframes: (B, N, KEYFRAME_NUMBERS) or None; velocity: (B, VELOCITY_NUMBERS) or None.
    """

    prefix: Tensor
    targets: Tensor
    text: Tensor
    text_mask: Tensor
    keyframes: Tensor | None = None
    velocity: Tensor | None = None


@dataclass(frozen=True)
class PlanState:
    """What `FoldedDip.denoise` needs of its plans.

    Attributes:
        head: (R, P, W) prefix tokens.
        added: (B, N, W) what every step adds to the plan frames of a request.
        row_of: (R,) request of each row.
        condition: (S, R, W); memory: with the condition of one step as its token 0.
        keys, bias, values: (S, D, R, H, W), (S, D, R, H), (S, D, R, H, W) of the conditions.
    """

    head: Tensor
    added: Tensor
    row_of: Tensor
    condition: Tensor
    memory: Memory
    keys: Tensor
    bias: Tensor
    values: Tensor


class Denoising(Protocol):
    """Runs the network step by step; see `FoldedDip`, which is one. `name` says by what and how precisely."""

    name: str

    def begin(self, given: Conditions, free: Tensor, numbers: Sequence[int]) -> Any:
        """What the steps share."""
        ...

    def denoise(self, state: Any, noisy: Tensor, position: int) -> Tensor:
        """(R, N, F) clean plans from (B, N, F) noisy ones."""
        ...


class FoldedDip:
    """A network rearranged for use.

    Args:
        network: in evaluation mode.
        quick, exact: what runs its blocks in all steps but the last of a plan, and in that one (see `runtime.Chosen`).
        name: of what runs them.
    """

    def __init__(self, network: DipNetwork, quick: Blocks, exact: Blocks, name: str = "torch float32"):
        self.name = name
        self._network, self._quick, self._exact = network, quick, exact
        config = network.config
        self._heads, self._depth = config.heads, len(network.layers)
        width, head = config.width, config.width // config.heads
        cross = [layer.cross_attention for layer in network.layers if isinstance(layer, DecoderLayer)]
        with torch.no_grad():
            scale = head**-0.5
            self._key_value = (
                torch.cat([each.key_value.weight for each in cross]),
                torch.cat([each.key_value.bias for each in cross]),
            )
            self._query = torch.stack([each.query.weight for each in cross]).view(-1, config.heads, head, width) * scale
            self._query_bias = torch.stack([each.query.bias for each in cross]).view(-1, config.heads, head, 1) * scale
            out = torch.stack([each.out.weight for each in cross]).view(-1, width, config.heads, head)
            self._out = out.permute(0, 2, 3, 1).contiguous()
            self._time = network.time_mlp(network.step_embedding)

    def begin(self, given: Conditions, free: Tensor, numbers: Sequence[int]) -> PlanState:
        """Everything that the steps share.

        Args:
            given: what is asked for.
            free: (R - B,) requests that also get a row without text, after the B with it.
            numbers: (S,) the diffusion steps that will be asked for, as positions in `denoise`, the last one first.
        """
        network, config = self._network, self._network.config
        batch, length = given.text_mask.shape
        constant = network.target_mlp(given.targets)
        if given.velocity is not None:
            constant = constant + network.velocity_in(given.velocity)
        with_text = constant
        if config.pooled_text:
            pooled = (given.text[:, 0] - network.text_mean) @ network.text_whitening
            with_text = constant + network.text_pool(pooled) * given.text_mask[:, :1]
        constant = torch.cat([with_text, constant[free]])
        rows, steps = len(constant), len(numbers)
        condition = self._time[list(numbers)][:, None] + constant[None]
        keys, bias, values = (t.view(steps, rows, *t.shape[1:]) for t in self._fold(condition.flatten(0, 1)))
        memory = self._memory(rows, -(-(1 + length) // MEMORY_MULTIPLE) * MEMORY_MULTIPLE)
        texts, text_of = torch.unique(given.text, dim=0, return_inverse=True)  # all tries of a deed have one
        of_text = self._fold(network.text_in(texts).flatten(0, 1))
        text_keys, text_bias, text_values = (t.view(len(texts), length, *t.shape[1:])[text_of] for t in of_text)
        by_token = (-1, batch, self._heads, memory.bias.shape[-1] // self._heads)
        token = slice(1, 1 + length)
        memory.keys[:, :batch].view(*by_token, config.width)[:, :, :, token] = text_keys.permute(2, 0, 3, 1, 4)
        memory.values[:, :batch].view(*by_token, config.width)[:, :, :, token] = text_values.permute(2, 0, 3, 1, 4)
        absent = ~given.text_mask[:, :, None, None]
        memory.bias[:, :batch].view(by_token)[:, :, :, token] = text_bias.masked_fill(absent, NO_TOKEN).permute(
            2, 0, 3, 1
        )
        row_of = torch.cat([torch.arange(batch), free])
        head = F.linear(given.prefix, network.frame_in.weight, network.frame_in.bias)
        added = network.place[config.prefix_frames :].expand(batch, -1, -1)
        if given.keyframes is not None:
            added = added + network.keyframe_in(given.keyframes)
        return PlanState(
            head=(head + network.place[: config.prefix_frames])[row_of],
            added=added,
            row_of=row_of,
            condition=condition,
            memory=memory,
            keys=keys.transpose(1, 2).contiguous(),
            bias=bias.transpose(1, 2).contiguous(),
            values=values.transpose(1, 2).contiguous(),
        )

    def denoise(self, state: PlanState, noisy: Tensor, position: int) -> Tensor:
        """(R, N, F) clean plans of all rows from (B, N, F) noisy ones, at the step `numbers[position]` of `begin`.

        The state's memory is written to: one step at a time.
        """
        network = self._network
        memory, depth, rows = state.memory, self._depth, len(state.row_of)
        by_token = (depth, rows, self._heads, -1)
        memory.keys.view(*by_token, network.config.width)[:, :, :, 0] = state.keys[position]
        memory.values.view(*by_token, network.config.width)[:, :, :, 0] = state.values[position]
        memory.bias.view(by_token)[:, :, :, 0] = state.bias[position]
        body = (network.frame_in(noisy) + state.added)[state.row_of]
        if network.config.condition_every_frame:
            body = body + state.condition[position][:, None]
        blocks = self._quick if position else self._exact
        out = blocks(torch.cat([state.head, body], dim=1), memory)
        clean: Tensor = network.frame_out(network.norm_out(out))
        return clean

    def _memory(self, rows: int, tokens: int) -> Memory:
        """With nothing in it."""
        columns, width = self._heads * tokens, self._network.config.width
        return Memory(
            torch.zeros(self._depth, rows, columns, width),
            torch.full((self._depth, rows, 1, columns), NO_TOKEN),
            torch.zeros(self._depth, rows, columns, width),
        )

    def _fold(self, tokens: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Keys (K, D, H, W), biases (K, D, H) and values (K, D, H, W), see `Memory`, of memory tokens (K, W)."""
        count = len(tokens)
        both = F.linear(tokens, *self._key_value).view(count, self._depth, 2, self._heads, -1)
        keys, values = both.permute(2, 1, 3, 0, 4)
        out = keys @ self._query, (keys @ self._query_bias)[..., 0], values @ self._out
        return out[0].permute(2, 0, 1, 3), out[1].permute(2, 0, 1), out[2].permute(2, 0, 1, 3)
