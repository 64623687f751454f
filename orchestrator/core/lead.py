"""How far ahead of its start a plan is asked for in real time."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from math import ceil, inf
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
ALONE_MOST_S = 0.165
"""A plan may be made a second time (`planner_service.dip.effort`): the longest is waited for up to here, by one
character alone too."""
CROWD, CROWDED_S = 3, 5.0
"""Where so many plans were under way at once not so long ago, processors are shared, too."""
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


class _Took:
    """What plans took, seconds.

    Attributes:
        usual: what nearly all of the last took. longest: the longest, but for those that hung.
    """

    def __init__(self) -> None:
        self.usual = self.longest = 0.0
        self._seconds: deque[float] = deque(maxlen=_REMEMBERED_LONGEST)
        self._cold = True

    def add(self, seconds: float) -> None:
        """One more. The first, for which the planner may have had to warm up, counts only until the second."""
        if self._cold and self._seconds:
            self._seconds.clear()
            self._cold = False
        self._seconds.append(seconds)
        self.usual = float(np.percentile(list(self._seconds)[-_REMEMBERED:], MOST_OF))
        self.longest = max(self.usual, min(max(self._seconds), HUNG * self.usual))


@dataclass(frozen=True)
class _Span:
    usual: float
    longest: float


class PlanLead:
    """Of one planner, for all characters that it plans for: as far as the settings say, and farther where plans take
    longer than that.

    A plan that comes too late is joined in late, or dropped by the tracker; where the planner is slow, every one would
    be, and the character would never move. Two kinds of plans are told apart:

    - For a command the lead is what is waited for: what nearly all of the last plans of like effort took, and a little
      longer; where the planner makes one other plan, after that one is done. Where it has several to make, it is what
      the longest of them took and what comes before it, since what is due first is planned first
      (`planner_service.service.batching`): one batch of whatever kind, and what was asked for other commands.
    - A plan that only goes on with what was asked for before is given more than the longest took, queues included: no
      one waits for it, as a command does not wait for it either (`drivers`).

    Args:
        now: seconds.
    """

    def __init__(self, now: Callable[[], float] = time.monotonic):
        self._now = now
        self._own: dict[Effort, _Took] = {}
        self._roomy = _Took()
        self._asked: list[Asked] = []
        self._given_up: list[Asked] = []
        self._crowded_until_s = -inf

    def asked(self, effort: Effort, roomy: bool) -> Asked:
        """A plan is asked for now; `ended` or `given_up` must follow."""
        asked = Asked(effort, roomy, self._now())
        self._asked.append(asked)
        if len(self._there()) >= CROWD:
            self._crowded_until_s = asked.began_s + CROWDED_S
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
        self._own.setdefault(asked.effort, _Took()).add(max(seconds - queued_s, 0.0))
        if asked.roomy:
            self._roomy.add(seconds)

    def ticks(self, least_ticks: int, effort: Effort = "once") -> int:
        """For the next plan for a command, or for one that aims at something."""
        if not self._own:
            return max(least_ticks, FIRST_TICKS)
        there, took = self._there(), self._of(effort)
        busy = len(there) > 1 or self._now() < self._crowded_until_s
        longest = took.longest + SPARE_S if busy else min(took.longest + SPARE_S, ALONE_MOST_S)
        seconds = max(SPARE * took.usual + SPARE_S, longest) + self._before_s(there)
        return max(least_ticks, min(ceil(seconds * TICK_HZ), MOST_TICKS))

    def roomy_ticks(self, least_ticks: int) -> int:
        """For the next plan that only goes on."""
        known = (*self._own.values(), self._roomy)
        usual = max(SPARE * took.usual + SPARE_S for took in known)
        longest = max(SPARE * took.longest + ROOMY_SPARE_S for took in known)
        wanted = ceil(max(usual, min(longest, ROOMY_MOST_S)) * TICK_HZ)
        return max(least_ticks, ROOMY_TICKS, min(wanted, MOST_TICKS))

    def _of(self, effort: Effort) -> _Span:
        """What plans of an effort take, or are likely to by what others did."""
        known = effort if effort in self._own else next(iter(self._own))
        took, times = self._own[known], COSTS[effort] / COSTS[known]
        return _Span(took.usual * times, took.longest * times)

    def _there(self) -> list[Asked]:
        """What the planner has still to make."""
        now = self._now()
        self._given_up = [each for each in self._given_up if self._ends_s(each) > now]
        return [*self._asked, *self._given_up]

    def _before_s(self, there: list[Asked]) -> float:
        """How long the planner has to do with it before it comes to a command."""
        if len(there) == 1:
            return max(self._ends_s(there[0]) - self._now(), 0.0)
        batch = max((self._of(each.effort).usual for each in there if each.roomy), default=0.0)
        return batch + sum(self._of(each.effort).usual for each in there if not each.roomy)

    def _ends_s(self, asked: Asked) -> float:
        """When a plan is there if the planner had nothing else to make."""
        return asked.began_s + (self._of(asked.effort).usual if self._own else 0.0)


def effort_of(goal: PlanGoal) -> Effort:
    """How much work a plan for a goal is."""
    if is_blow(goal.text, goal.targets):
        return "blow"
    return "wave" if goal.text is not None and not goal.targets and kind_of(goal.text) == "wave" else "once"
