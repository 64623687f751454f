"""Advancing a character: lockstep (as fast as it goes, deterministic) and realtime (planning beside the physics)."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

from orchestrator.core.keepsake import Pace
from orchestrator.core.lead import Asked, PlanLead, effort_of
from orchestrator.core.loop import CharacterLoop, GoalSource, PlanTiming, timing_of, view_of
from orchestrator.core.pacing import PlanPacer
from shared.errors import MotionLoopError, SimulationError, TransportError
from shared.protocol.messages import TICK_HZ, Plan, StateFrame
from shared.tasks.interface import PlanGoal, Trace

PLANNER_RETRY_S, PLANNER_RETRY_TICKS = 0.25, 6
"""After so long a planner that was away is asked again: by the clock, and in lockstep."""
BAD_PLANS_IN_A_ROW = 4


@dataclass(frozen=True)
class Cycle:
    """What one cycle brought: the state after it, the ticks it covered, the plans, and whether the planner answered.

    Attributes:
        trace: the ticks after the previous cycle's up to the state's own.
        planner_error: why no plan came, or None.
        put_back: the character's tracker was lost: it is what was kept of it earlier, and this cycle let no time pass.
    """

    state: StateFrame
    trace: Trace
    plans: tuple[PlanTiming, ...] = ()
    planner_error: str | None = None
    put_back: bool = False


class Driver(Protocol):
    """One way to let time pass."""

    async def cycle(self, source: GoalSource, max_ticks: int | None = None) -> Cycle:
        """Let the character go on for a while under `source`; raises TransportError when the tracker is gone."""
        ...

    def replan_now(self) -> None:
        """A command changed: do not wait for the replan period."""
        ...

    @property
    def by_clock(self) -> bool:
        """Whether the tracker's clock drives the character, and not `cycle`."""
        ...

    def saw(self, state: StateFrame) -> None:
        """Something was done to character or scene between cycles: this is how it is now."""
        ...

    async def drop_plan(self) -> None:
        """The body was put somewhere else: what is being planned for it says nothing any more. Plan anew."""
        ...

    def pace(self) -> Pace:
        """Where it is, for `go_on`."""
        ...

    async def go_on(self, state: StateFrame, pace: Pace, seen_tick: int) -> None:
        """The character is found again as `state`: go on as at the time of `pace`; what was seen of it ends at
        `seen_tick`."""
        ...

    async def close(self) -> None:
        """Stop whatever is under way."""
        ...


class _BadPlans:
    """Plans that no body could follow, in a row. A planner may make one from a body that is toppling; the old plan goes
    on then and the next has another prefix and seed. Too many are an error."""

    def __init__(self) -> None:
        self.in_a_row = 0

    def count(self, error: SimulationError) -> None:
        """One more; raises it when it is one too many."""
        self.in_a_row += 1
        if self.in_a_row > BAD_PLANS_IN_A_ROW:
            raise error

    def clear(self) -> None:
        """A good one came."""
        self.in_a_row = 0


def _unavailable(error: MotionLoopError) -> bool:
    """Whether the planner is away or overloaded, as against having refused this one request."""
    return isinstance(error, TransportError) or error.retryable


class _Paced:
    """What both drivers keep of plans in time: when the next is due, the one in force, and bad ones in a row."""

    def __init__(self, loop: CharacterLoop, start: StateFrame):
        self._loop = loop
        self._state = start
        self._seen = start.tick
        self._next_plan_tick = start.tick
        self._pacer = PlanPacer(loop.settings.least_ticks)
        self._bad = _BadPlans()

    def replan_now(self) -> None:
        """Plan as soon as may be: at the next tick that is a frame of the planner, or when the plan under way has
        landed."""
        self._next_plan_tick = self._state.tick

    def saw(self, state: StateFrame) -> None:
        """The next plan is made for it as it is now."""
        self._state = state

    def pace(self) -> Pace:
        """When the next plan is due, the plan in force, and those that came early or were bad."""
        entered, early = self._pacer.remembered()
        return Pace(next_plan_tick=self._next_plan_tick, entered=entered, early=early, bad_plans=self._bad.in_a_row)

    def _set(self, state: StateFrame, pace: Pace, seen_tick: int) -> None:
        # By the clock the character may have been kept after the last look: those ticks are still to be seen.
        self._state, self._seen, self._next_plan_tick = state, min(self._seen, seen_tick), pace.next_plan_tick
        self._pacer.remember(pace.entered, pace.early)
        self._bad.in_a_row = pace.bad_plans


class LockstepDriver(_Paced):
    """Plan, wait for it, advance by the replan period. The same seed gives the same log.

    While the planner is away the physics goes on at the pace of the wall clock, on the tracker's standing extension,
    so that an outage costs simulated time and not thousands of ticks.
    """

    by_clock = False

    async def go_on(self, state: StateFrame, pace: Pace, seen_tick: int) -> None:
        """Nothing is under way between cycles: as it was then, and so the same log comes."""
        self._set(state, pace, seen_tick)

    async def drop_plan(self) -> None:
        """Nothing is under way between cycles: plan anew."""
        self._pacer.clear()
        self.replan_now()

    async def close(self) -> None:
        """Nothing runs between cycles."""

    async def cycle(self, source: GoalSource, max_ticks: int | None = None) -> Cycle:
        """One plan (when due) and the ticks until the next, at most `replan_ticks` and `max_ticks`."""
        settings = self._loop.settings
        tick, spacing = self._state.tick, self._loop.start_spacing()
        plans: list[PlanTiming] = []
        trouble: str | None = None
        if tick >= self._next_plan_tick and tick % spacing == 0:
            lead = settings.plan_lead_ticks if self._loop.has_plan else 0
            start_tick = self._pacer.start_tick(tick, lead, self._loop.planner_spec().fps)
            began = time.perf_counter()
            period = settings.replan_ticks
            try:
                goal = source(view_of(self._state), start_tick)
                period = self._loop.period_ticks(goal)
                plan = await self._loop.make_plan(goal, tick, start_tick)
            except SimulationError as error:
                self._bad.count(error)
                period = min(period, settings.replan_ticks)
            except MotionLoopError as error:
                if not _unavailable(error):
                    raise
                trouble = error.message
                period = max(PLANNER_RETRY_TICKS // spacing, 1) * spacing
            else:
                self._bad.clear()
                period = self._loop.period_ticks(goal, plan)
                reply = await self._loop.track(plan)
                if reply.accepted:
                    self._pacer.entered(start_tick, period)
                total_ms = (time.perf_counter() - began) * 1e3
                plans.append(timing_of(plan, self._loop.plans_made - 1, reply, total_ms, goal.text))
            self._next_plan_tick = tick + period
        ticks = max(min(self._next_plan_tick - tick, settings.replan_ticks), spacing - tick % spacing)
        ticks = ticks if max_ticks is None else max(1, min(ticks, max_ticks))
        if trouble is not None:
            await asyncio.sleep(ticks / TICK_HZ)
        self._state = await self._loop.step(ticks)
        trace = await self._loop.trace(self._seen + 1, self._state.tick + 1)
        self._seen = self._state.tick
        return Cycle(self._state, trace, tuple(plans), trouble)


@dataclass
class _Request:
    """A plan under way, asked for at `tick` for a new command or as one goes on; `lead` is its planner's."""

    task: asyncio.Task[Plan]
    tick: int
    start_tick: int
    goal: PlanGoal
    commanded: bool
    lead: PlanLead
    asked: Asked
    began_s: float = field(default_factory=time.perf_counter)


class RealtimeDriver(_Paced):
    """The tracker's clock runs; plans are requested as far ahead as `PlanLead` says and handed over when they come.

    A cycle is one look at the character (`poll_s`, sooner when a plan or a command comes): it never waits for the
    planner. One plan is under way at a time. A command that comes meanwhile lets one for another command land and is
    planned for right after it, so that commands which come faster than plans are made steer and do not starve; of
    several, the newest is planned for. A plan that only goes on with what was asked for before is given up for it, and
    one that has landed but has still to enter is cut off. So such plans may be asked for long before they enter, but
    for those that aim at something, which see as late as they can where the body is.
    """

    by_clock = True

    def __init__(
        self, loop: CharacterLoop, start: StateFrame, lead_of: Callable[[str], PlanLead], poll_s: float = 0.033
    ):
        super().__init__(loop, start)
        self._lead_of = lead_of
        self._poll_s = poll_s
        self._look_at_s = time.monotonic()
        self._request: _Request | None = None
        self._retry_at_s = 0.0
        self._aims = False
        self._trouble: str | None = None
        self._commanded = False
        self._woken: asyncio.Future[None] | None = None

    def replan_now(self) -> None:
        """Plan at once, or when the plan under way for another command has landed."""
        super().replan_now()
        self._commanded = True
        if self._woken is not None and not self._woken.done():
            self._woken.set_result(None)

    async def go_on(self, state: StateFrame, pace: Pace, seen_tick: int) -> None:
        """The plan under way was made for a body that is somewhere else now: another is asked for at once."""
        await self.close()
        self._set(state, pace, seen_tick)
        self.replan_now()

    async def drop_plan(self) -> None:
        """Throw away the plan under way, and plan anew."""
        await self.close()
        self._pacer.clear()
        self.replan_now()

    async def close(self) -> None:
        """Give up the plan under way."""
        request, self._request = self._request, None
        if request is not None:
            request.lead.given_up(request.asked)
            request.task.cancel()
            with contextlib.suppress(asyncio.CancelledError, MotionLoopError):
                await request.task

    async def cycle(self, source: GoalSource, max_ticks: int | None = None) -> Cycle:
        """Wait one poll, collect a plan that has come, look, and request one that is due."""
        await self._until_look()
        plans: list[PlanTiming] = []
        if self._request is not None and self._request.task.done():
            landed, self._request = self._request, None  # first of all: one that raises must not be met again
            plans.extend(await self._collect(landed))
        self._state, trace = await self._loop.look(self._seen + 1)
        tick = self._state.tick
        if self._may_launch() and tick >= self._next_plan_tick:
            await self.close()
            self._launch(source, tick)
        self._seen = max(self._seen, tick)
        return Cycle(self._state, trace, tuple(plans), self._trouble)

    def _may_launch(self) -> bool:
        free = self._request is None or (self._commanded and not self._request.commanded and self._loop.has_plan)
        return free and not self._state.paused and time.monotonic() >= self._retry_at_s

    async def _until_look(self) -> None:
        """Looks are due at a fixed rate, since what a look takes must not slow what viewers are shown; a plan that
        lands and a command are taken up at once."""
        now = time.monotonic()
        due_at_s = max(self._look_at_s + self._poll_s, now)
        if not (self._commanded and self._may_launch()):
            self._woken = asyncio.get_running_loop().create_future()
            wakes = (self._woken,) if self._request is None else (self._woken, self._request.task)
            await asyncio.wait(wakes, timeout=due_at_s - now, return_when=asyncio.FIRST_COMPLETED)
        self._look_at_s = min(due_at_s, max(time.monotonic(), self._look_at_s))

    def _launch(self, source: GoalSource, tick: int) -> None:
        spec, least = self._loop.planner_spec(), self._loop.settings.plan_lead_ticks
        lead = self._lead_of(spec.name)
        roomy = not self._commanded and not self._aims
        ahead = lead.roomy_ticks(least) if roomy else lead.ticks(least)
        start_tick = self._pacer.start_tick(tick, ahead, spec.fps)
        goal = source(view_of(self._state), start_tick)
        effort, self._aims = effort_of(goal), bool(goal.targets)
        if not roomy and effort != "once":  # and so without a place to be at by then
            start_tick = self._pacer.start_tick(tick, lead.ticks(least, effort), spec.fps)
        task = asyncio.create_task(self._loop.make_plan(goal, tick, start_tick))
        lead = self._lead_of(self._loop.planner_spec(goal.planner).name)
        asked, period = lead.asked(effort, roomy), self._loop.period_ticks(goal)
        self._request = _Request(task, tick, start_tick, goal, self._commanded, lead, asked)
        self._commanded = False
        self._next_plan_tick = self._next_after(self._request, period)

    def _next_after(self, request: _Request, period_ticks: int) -> int:
        """When the plan after one that is meant to run for `period_ticks` is asked for."""
        if self._aims:
            return request.tick + period_ticks
        ahead = request.lead.roomy_ticks(self._loop.settings.plan_lead_ticks)
        return max(request.start_tick + period_ticks - ahead, self._state.tick + 1)

    async def _collect(self, request: _Request) -> list[PlanTiming]:
        request.lead.ended(request.asked)
        try:
            plan = request.task.result()
        except asyncio.CancelledError:
            return []
        except SimulationError as error:
            self._bad.count(error)
            self._again(request)
            return []
        except MotionLoopError as error:
            if not _unavailable(error):
                raise
            self._trouble = error.message
            self._retry_at_s = time.monotonic() + PLANNER_RETRY_S
            self._again(request)
            return []
        self._trouble = None
        self._bad.clear()
        if self._commanded and not request.commanded and self._loop.has_plan:
            return []
        took_s = time.perf_counter() - request.began_s
        reply = await self._loop.track(plan)
        request.lead.took(request.asked, plan.timings_ms.get("queue", 0.0) / 1e3)
        if reply.accepted:
            period = self._loop.period_ticks(request.goal, plan)
            self._pacer.entered(plan.start_tick, period, goes_on=not request.commanded)
            if self._next_plan_tick > self._state.tick:  # no command came meanwhile
                self._next_plan_tick = self._next_after(request, period)
        else:
            self._again(request)
        return [timing_of(plan, self._loop.plans_made - 1, reply, took_s * 1e3, request.goal.text)]

    def _again(self, request: _Request) -> None:
        self._next_plan_tick = self._state.tick
        self._commanded = self._commanded or request.commanded
