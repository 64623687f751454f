"""How far ahead of its start a plan is asked for in real time."""

from __future__ import annotations

from collections import deque
from math import ceil
from typing import Literal

import numpy as np

from shared.protocol.rates import TICK_HZ
from shared.tasks.interface import PlanGoal
from shared.tasks.obey import is_blow, kind_of

MOST_TICKS = 75
"""A tracker takes no plan that starts more than three seconds ahead."""
FIRST_TICKS = 9
"""Before anything is known of how long plans take."""
SPARE, SPARE_S = 1.2, 0.02
"""So many times as long as that, and so much longer, is waited for."""
MOST_OF = 90
"""Percentile: a few that hung are no measure."""
Effort = Literal["once", "wave", "blow"]
COSTS: dict[Effort, float] = {"once": 1.0, "wave": 1.8, "blow": 3.0}
"""Waves and blows are planned for several times (`planner_service.dip.deeds`): how much longer that takes, where it is
not known yet."""
_REMEMBERED = 20


class PlanLead:
    """As far as the settings say, and farther where plans take longer than that.

    A plan that comes too late is joined in late, or dropped by the tracker; where the planner is slow, every one would
    be, and the character would never move. So what nearly all of the last plans of like effort took is waited for, and
    a little longer.

    Args:
        least_ticks: the settings' lead.
    """

    def __init__(self, least_ticks: int):
        self._least_ticks = least_ticks
        self._took_s: dict[Effort, deque[float]] = {}
        self._cold: set[Effort] = set()

    def took(self, seconds: float, effort: Effort = "once") -> None:
        """A plan was made; `seconds` from its request until the tracker had it. The first of an effort, for which the
        planner may have had to warm up, counts only until the second."""
        if effort not in self._took_s:
            self._cold.add(effort)
            self._took_s[effort] = deque(maxlen=_REMEMBERED)
        elif effort in self._cold:
            self._cold.remove(effort)
            self._took_s[effort].clear()
        self._took_s[effort].append(seconds)

    def ticks(self, effort: Effort = "once") -> int:
        """For the next plan."""
        known = effort if effort in self._took_s else next(iter(self._took_s), None)
        if known is None:
            return max(self._least_ticks, FIRST_TICKS)
        wanted_s = float(np.percentile(self._took_s[known], MOST_OF)) * COSTS[effort] / COSTS[known]
        return max(self._least_ticks, min(ceil((SPARE * wanted_s + SPARE_S) * TICK_HZ), MOST_TICKS))


def effort_of(goal: PlanGoal) -> Effort:
    """How much work a plan for a goal is."""
    if is_blow(goal.text, goal.targets):
        return "blow"
    return "wave" if goal.text is not None and not goal.targets and kind_of(goal.text) == "wave" else "once"
