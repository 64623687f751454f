"""When the next plan enters: soon after a command, but not so often that a body cannot follow."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from orchestrator.core.stitch import start_tick_for
from shared.protocol.rates import PLANNER_FPS, TICK_HZ

EARLY_PLANS = 2
EARLY_WITHIN_TICKS = 4 * TICK_HZ
LONGEST_WAIT_TICKS = 2 * TICK_HZ
"""A way up from the floor is performed for longer than anyone waits for another plan, and than a tracker takes plans
ahead of time."""


@dataclass(frozen=True)
class _Entered:
    """A plan in force: where it entered, for how many ticks it is meant to run, and whether it only goes on with what
    was done before it."""

    start_tick: int
    period_ticks: int
    goes_on: bool = False

    @property
    def end_tick(self) -> int:
        """Where another is meant to take over."""
        return self.start_tick + self.period_ticks


class PlanPacer:
    """Start ticks of plans that may be asked for faster than a body can follow.

    A walking body falls when its motion is begun anew ten times a second. So of the plans that cut their predecessor
    off before its period only two in four seconds enter at once, at least `least_ticks` after one that began something
    new; others wait for the end of that period. While a plan has still to enter, with time enough to make another, the
    other takes its place unseen: commands that come at any rate are all planned for, and what enters was made for the
    newest of them. One that only goes on and has still to enter is no reason to wait: the plan before it counts.

    Args:
        least_ticks: the least that a plan runs before another takes over.
    """

    def __init__(self, least_ticks: int):
        self._least_ticks = least_ticks
        self._last: _Entered | None = None
        self._before: _Entered | None = None
        self._early: deque[int] = deque(maxlen=EARLY_PLANS)

    def start_tick(self, now_tick: int, lead_ticks: int, fps: int = PLANNER_FPS) -> int:
        """Where a plan at `fps` asked for now enters: a tick at least `lead_ticks` ahead that is a frame of it."""
        soonest = start_tick_for(now_tick, lead_ticks, fps)
        last = self._last
        if last is None:
            return soonest
        if last.start_tick < soonest:
            return self._after(last, soonest, fps)
        replaced = start_tick_for(last.start_tick, 0, fps)
        before = self._before
        if not last.goes_on or before is None:
            return replaced
        if before.start_tick >= soonest:
            return start_tick_for(before.start_tick, 0, fps)
        return min(replaced, self._after(before, soonest, fps))

    def entered(self, start_tick: int, period_ticks: int, goes_on: bool = False) -> None:
        """A plan was accepted, and is meant to run for `period_ticks`; `goes_on`: no command is new in it,
        and so it is not early."""
        last = self._last
        replaced = last if last is not None and last.start_tick >= start_tick else None
        if replaced is None:
            self._before = last
        before, counted = self._before, replaced is not None and not replaced.goes_on
        if not goes_on and not counted and before is not None and before.start_tick < start_tick < before.end_tick:
            self._early.append(start_tick)
        self._last = _Entered(start_tick, period_ticks, goes_on)

    def remembered(self) -> tuple[tuple[int, int] | None, tuple[int, ...]]:
        """Start and period of the plan in force, and the starts of early ones, for `remember`."""
        last = self._last
        return None if last is None else (last.start_tick, last.period_ticks), tuple(self._early)

    def remember(self, entered: tuple[int, int] | None, early: tuple[int, ...]) -> None:
        """Go on from what was in force."""
        self._last, self._before = None if entered is None else _Entered(*entered), None
        self._early = deque(early, maxlen=EARLY_PLANS)

    def clear(self) -> None:
        """The body was put somewhere else: nothing is in force."""
        self._last = self._before = None
        self._early.clear()

    def _after(self, last: _Entered, soonest: int, fps: int) -> int:
        return max(soonest, start_tick_for(last.start_tick, self._gap(last, soonest), fps))

    def _gap(self, last: _Entered, soonest: int) -> int:
        spent = len(self._early) == EARLY_PLANS and soonest - self._early[0] < EARLY_WITHIN_TICKS
        if spent:
            return min(last.period_ticks, LONGEST_WAIT_TICKS)
        return 0 if last.goes_on else min(self._least_ticks, last.period_ticks)
