"""How far ahead of its start a plan is asked for in real time."""

from __future__ import annotations

from collections import deque
from math import ceil

import numpy as np

from shared.protocol.rates import TICK_HZ

MOST_TICKS = 75
"""A tracker takes no plan that starts more than three seconds ahead."""
_REMEMBERED = 5


class PlanLead:
    """As far as the settings say, and farther where plans take longer than that.

    A plan that comes too late is dropped by the tracker. Where the planner is slow, every one would be, and the
    character would never move; so what most of the last plans took is waited for (their upper quartile: one that hung
    is no measure).

    Args:
        least_ticks: the settings' lead.
    """

    def __init__(self, least_ticks: int):
        self._least_ticks = least_ticks
        self._took_s: deque[float] = deque(maxlen=_REMEMBERED)

    def took(self, seconds: float) -> None:
        """A plan was made; `seconds` from its request until it was there."""
        self._took_s.append(seconds)

    @property
    def ticks(self) -> int:
        """For the next plan."""
        if not self._took_s:
            return self._least_ticks
        return max(self._least_ticks, min(ceil(float(np.percentile(self._took_s, 75)) * TICK_HZ), MOST_TICKS))
