"""How far ahead of its start a plan is asked for in real time."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
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
HUNG = 3.0
"""What took so many times as long as nearly all hung, and is no measure of the longest either."""
ROOMY_TICKS, ROOMY_SPARE_S, ROOMY_MOST_S = 12, 0.1, 0.8
"""The least for a plan that only goes on, what it is given beyond the longest, and up to where that goes: of the prefix
so much is what was planned and not what was done."""
Effort = Literal["once", "wave", "blow"]
COSTS: dict[Effort, float] = {"once": 1.0, "wave": 1.8, "blow": 3.0}
"""Waves and blows are planned for several times (`planner_service.dip.deeds`): how much longer that takes, where it is
not known yet."""
_REMEMBERED, _REMEMBERED_LONGEST = 20, 60


@dataclass(frozen=True)
class Asked:
    """A plan that was asked for, and when (seconds of the clock).

    Attributes:
        roomy: with much time: where the planner has several to make, others come first.
    """

    effort: Effort
    roomy: bool
    began_s: float


@dataclass
class _Took:
    """What plans took, seconds, the newest last."""

    seconds: deque[float] = field(default_factory=lambda: deque(maxlen=_REMEMBERED_LONGEST))
    cold: bool = True

    def add(self, seconds: float) -> None:
        """One more. The first, for which the planner may have had to warm up, counts only until the second."""
        if self.cold and self.seconds:
            self.seconds.clear()
            self.cold = False
        self.seconds.append(seconds)

    @property
    def usual(self) -> float:
        """What nearly all of the last took."""
        return float(np.percentile(list(self.seconds)[-_REMEMBERED:], MOST_OF))

    @property
    def longest(self) -> float:
        """The longest, but for those that hung."""
        return max(self.usual, min(max(self.seconds), HUNG * self.usual))


@dataclass(frozen=True)
class _Span:
    usual: float
    longest: float


class PlanLead:
    """Of one planner, for all characters that it plans for: as far as the settings say, and farther where plans take
    longer than that.

    A plan that comes too late is joined in late, or dropped by the tracker; where the planner is slow, every one would
    be, and the character would never move. Two kinds of plans are told apart:

    - For a command the lead is what is waited for. While the planner has nothing else to make, it is what nearly all of
      the last plans of like effort took, and a little longer. Else it is what the longest of them took and what is
      before it at the planner, which makes first what is due first (`planner_service.service.batching`): one batch of
      whatever kind, and what was asked for other commands.
    - A plan that only goes on with what was asked for before is given more than the longest took, queues included: no
      one waits for it, as a command does not wait for it either (`drivers`).

    Args:
        now: seconds.
    """

    def __init__(self, now: Callable[[], float] = time.monotonic):
        self._now = now
        self._own: dict[tuple[Effort, bool], _Took] = {}
        self._roomy = _Took()
        self._asked: list[Asked] = []
        self._given_up: list[Asked] = []

    def asked(self, effort: Effort, roomy: bool) -> Asked:
        """A plan is asked for now; `ended` or `given_up` must follow."""
        asked = Asked(effort, roomy, self._now())
        self._asked.append(asked)
        return asked

    def ended(self, asked: Asked) -> None:
        """The planner has answered, or is not waited for any longer."""
        self._asked.remove(asked)

    def given_up(self, asked: Asked) -> None:
        """No one waits for a plan any longer, but the planner makes it all the same."""
        self._asked.remove(asked)
        self._given_up.append(asked)

    def took(self, asked: Asked, queued_s: float = 0.0) -> None:
        """The tracker has a plan; `queued_s` of the time since it was asked for it waited at the planner for others."""
        seconds = self._now() - asked.began_s
        self._own.setdefault((asked.effort, asked.roomy), _Took()).add(max(seconds - queued_s, 0.0))
        if asked.roomy:
            self._roomy.add(seconds)

    def ticks(self, least_ticks: int, effort: Effort = "once") -> int:
        """For the next plan for a command, or for one that aims at something."""
        if not self._own:
            return max(least_ticks, FIRST_TICKS)
        before_s = self._before_s()
        took = self._of(effort, roomy=False)
        seconds = SPARE * (took.usual if before_s is None else took.longest) + SPARE_S + (before_s or 0.0)
        return max(least_ticks, min(ceil(seconds * TICK_HZ), MOST_TICKS))

    def roomy_ticks(self, least_ticks: int) -> int:
        """For the next plan that only goes on."""
        known = [*self._own.values(), *([self._roomy] if self._roomy.seconds else [])]
        usual = max((SPARE * took.usual + SPARE_S for took in known), default=0.0)
        longest = max((SPARE * took.longest + ROOMY_SPARE_S for took in known), default=0.0)
        wanted = ceil(max(usual, min(longest, ROOMY_MOST_S)) * TICK_HZ)
        return max(least_ticks, ROOMY_TICKS, min(wanted, MOST_TICKS))

    def _of(self, effort: Effort, roomy: bool) -> _Span:
        """What plans of an effort take, or are likely to by what others did."""
        known = min(self._own, key=lambda each: (each[0] != effort, each[1] != roomy))
        took, times = self._own[known], COSTS[effort] / COSTS[known[0]]
        return _Span(took.usual * times, took.longest * times)

    def _before_s(self) -> float | None:
        """How long the planner has still to do with what it was asked for before; None when there is nothing."""
        now = self._now()
        self._given_up = [each for each in self._given_up if self._ends_s(each) > now]
        there = [*self._asked, *self._given_up]
        if not there:
            return None
        if len(there) == 1:
            return max(self._ends_s(there[0]) - now, 0.0)
        batch = max((self._of(each.effort, True).usual for each in there if each.roomy), default=0.0)
        return batch + sum(self._of(each.effort, False).usual for each in there if not each.roomy)

    def _ends_s(self, asked: Asked) -> float:
        """When a plan is there if the planner had nothing else to make."""
        return asked.began_s + (self._of(asked.effort, asked.roomy).usual + SPARE_S if self._own else 0.0)


def effort_of(goal: PlanGoal) -> Effort:
    """How much work a plan for a goal is."""
    if is_blow(goal.text, goal.targets):
        return "blow"
    return "wave" if goal.text is not None and not goal.targets and kind_of(goal.text) == "wave" else "once"
