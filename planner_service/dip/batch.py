"""What a batch of plans is sampled from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from torch import Tensor

from planner_service.dip.manner import Manner
from planner_service.dip.wishes import Wishes
from shared.motion.features import RootState

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Batch:
    """What plans of B requests are sampled from, and where they go on.

    Attributes:
        prefixes: features (P, F) of each; states: root of the last prefix frame. wishes: targets and the like.
        taken_as: the trained sentence that each text is planned for, None where that is the text.
        prefix: (B, P, F) normalised. text: (B, L, D) with mask (B, L). manners: how each is sampled.
        noise: (steps, B, N, F). timings_ms: what it took.
    """

    prefixes: list[Array]
    states: list[RootState]
    wishes: Wishes
    taken_as: list[str | None]
    prefix: Tensor
    text: Tensor
    mask: Tensor
    manners: list[Manner]
    noise: Tensor
    timings_ms: dict[str, float]

    def only(self, rows: Sequence[int]) -> Batch:
        """Some of the requests, in this order."""
        picked = list(rows)
        return Batch(
            prefixes=[self.prefixes[row] for row in picked],
            states=[self.states[row] for row in picked],
            wishes=self.wishes.only(picked),
            taken_as=[self.taken_as[row] for row in picked],
            prefix=self.prefix[picked],
            text=self.text[picked],
            mask=self.mask[picked],
            manners=[self.manners[row] for row in picked],
            noise=self.noise[:, picked],
            timings_ms=self.timings_ms,
        )
