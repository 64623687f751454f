"""DiP as one would write it down: the network that is trained, in float32, every pass by itself.

What the others are compared with, in cost and in what comes out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from planner_service.dip.folded import Conditions
from planner_service.dip.network import DipNetwork


@dataclass(frozen=True)
class PlainState:
    """Conditions of the requests; `free`: those that get a row without text, too; `numbers`: the steps."""

    given: Conditions
    free: Tensor
    numbers: Sequence[int]


class PlainDip:
    """A `folded.Denoising` that computes everything at every step, with text and without in two passes."""

    name = "torch float32, plainly"

    def __init__(self, network: DipNetwork):
        self._network = network

    def begin(self, given: Conditions, free: Tensor, numbers: Sequence[int]) -> PlainState:
        """Nothing is prepared."""
        return PlainState(given, free, numbers)

    def denoise(self, state: PlainState, noisy: Tensor, position: int) -> Tensor:
        """See `folded.FoldedDip.denoise`."""
        number = state.numbers[position]
        with_text = self._pass(state.given, noisy, number, torch.arange(len(noisy)), state.given.text_mask)
        if not len(state.free):
            return with_text
        nothing = torch.zeros_like(state.given.text_mask[state.free])
        return torch.cat([with_text, self._pass(state.given, noisy, number, state.free, nothing)])

    def _pass(self, given: Conditions, noisy: Tensor, number: int, rows: Tensor, mask: Tensor) -> Tensor:
        out: Tensor = self._network(
            noisy[rows],
            torch.full((len(rows),), number, dtype=torch.int64),
            given.prefix[rows],
            given.targets[rows],
            given.text[rows],
            mask,
            None if given.keyframes is None else given.keyframes[rows],
            None if given.velocity is None else given.velocity[rows],
        )
        return out
