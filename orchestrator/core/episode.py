"""An episode: tasks one after another on one character, driven by the state machine."""

from __future__ import annotations

import logging
from collections.abc import Awaitable, Callable
from dataclasses import asdict, replace
from typing import Literal

from orchestrator.core.agenda import Agenda
from orchestrator.core.drivers import Cycle
from orchestrator.core.episode_spec import EpisodeOutcome, EpisodeSpec
from orchestrator.core.events import EventLog
from orchestrator.core.keepsake import EpisodeState, Keepsake, MachineView
from orchestrator.core.loop import view_of
from orchestrator.core.machine import (
    Action,
    MachineState,
    Phase,
    Signal,
    timed_out,
    transition,
    with_limit,
)
from orchestrator.core.on_fall import Down, get_up_goal
from orchestrator.core.performing import Performing, props_of
from orchestrator.core.services import Services
from orchestrator.core.session import PutBackError, Session
from orchestrator.rest import TaskResult
from shared.errors import ConflictError, MotionLoopError, NotFoundError, TransportError
from shared.protocol.messages import TICK_HZ, StateFrame
from shared.tasks.factory import TaskSpec
from shared.tasks.interface import BodyView, PlanGoal, Trace, Verdict
from shared.tasks.rules import SAFE_TICKS
from shared.text.wording import STAND_TEXT

log = logging.getLogger(__name__)

STOOD_UP_TICKS = 15
REPORT_TICKS = 15


class EpisodeRunner:
    """Runs one episode to its end, whatever happens on the way; `run` never hangs, since every wait has a deadline.

    Args:
        episode_id: also the character's id at the tracker, where the character stays until it is closed.
        spec: what to do.
        services: planner and tracker.
        events: where to say what happens.
        on_cycle: called after every cycle (live state, recording).
    """

    def __init__(
        self,
        episode_id: str,
        spec: EpisodeSpec,
        services: Services,
        events: EventLog,
        on_cycle: Callable[[Cycle], Awaitable[None]] | None = None,
    ):
        self.episode_id = episode_id
        self.spec = spec
        self.events = events
        self.results: list[TaskResult] = []
        self.tick = 0
        self.session = Session(episode_id, spec, services, events, spec.heading_rad)
        self.session.on_rewind.append(self._rewind)
        self.on_cycle = on_cycle
        self._agenda = Agenda(spec.tasks, spec.order, spec.seed)
        self._machine = MachineState()
        self._running: Performing | None = None
        self._resume_from: Keepsake | None = None
        self._at_kept: tuple[EpisodeState, Performing | None] | None = None
        self._skips: set[int] = set()
        self._down = Down()
        self._cancelled = False
        self._reason: str | None = None
        self._missed = 0
        self._last_report = 0

    @property
    def phase(self) -> Phase:
        """Where the state machine is."""
        return self._machine.phase

    def cancel(self) -> None:
        """End the episode at the next cycle."""
        self._cancelled = True
        self.session.give_up()

    def skip(self) -> int:
        """End the task being performed as failed and go on with the next; returns its index.

        Raises ConflictError when none is being performed.
        """
        if self._running is None or self.phase not in (Phase.ACTING, Phase.SETTLING):
            raise ConflictError(f"no task is being performed, the episode is {self.phase}", field="id")
        self._skips.add(self._running.index)
        return self._running.index

    def insert(self, task: TaskSpec, place: int) -> int:
        """Add a task before what is `place`-th to come; returns its index. Raises ConflictError when it is over."""
        if self._machine.over:
            raise ConflictError(f"the episode is {self.phase}", field="id")
        task.check(self.session.scene)
        index = self._agenda.insert(task, place)
        self.session.keep_soon()
        self.events.emit("task_inserted", self.tick, index=index, place=place, task=task.model_dump(mode="json"))
        return index

    def remembered(self) -> EpisodeState:
        """Where it is, for `take_up`."""
        return EpisodeState(
            machine=MachineView(**asdict(self._machine)),
            agenda=self._agenda.remembered(),
            results=list(self.results),
            performing=None if self._running is None else self._running.state(),
            down=self._down.is_so,
            missed_ticks=self._missed,
            last_report=self._last_report,
            reason=self._reason,
        )

    def take_up(self, state: EpisodeState, kept: Keepsake, trace: Trace) -> None:
        """Let `run` go on with an episode of an earlier process, instead of beginning one.

        Args:
            state, kept: as that process wrote them.
            trace: what had happened by then, from tick 0.
        """
        self._agenda.remember(state.agenda)
        self._set(state, kept.tick)
        if (doing := state.performing) is not None:
            task, scene = self._agenda.make(doing.index), self.session.choose_scene()
            since = trace.since(doing.begin_tick)
            loop = self.session.loop
            loop.remember(kept.loop, kept.planned_w_m)
            self._running = Performing.again(doing, task, since, self.spec.character, scene, loop.planned)
        self._resume_from = kept
        self._at_kept = state, self._running

    def _set(self, state: EpisodeState, tick: int) -> None:
        """All but agenda and task as they were at a tick."""
        self.tick, self._missed, self._last_report = tick, state.missed_ticks, state.last_report
        self._machine = MachineState(**state.machine.model_dump())
        self.results, self._down.is_so, self._reason = list(state.results), state.down, state.reason

    async def run(self) -> EpisodeOutcome:
        """Create the character, perform the tasks, say how it went. Never raises for what services do."""
        try:
            if self._resume_from is None:
                await self.session.start()
                await self._keep()
            else:
                await self.session.take_up(self._resume_from)
                self.events.emit("resumed", self._resume_from.tick, phase=self._machine.phase)
            while not self._machine.over:
                await self._turn()
        except (TransportError, NotFoundError) as error:
            await self._end_with(f"the tracker is gone: {error.message}")
        except MotionLoopError as error:
            await self._end_with(error.message)
        finally:
            await self.session.stop()
        return self._outcome()

    async def _end_with(self, reason: str) -> None:
        """What is needed to go on is not there."""
        if not self._machine.over:
            self._reason = "cancelled" if self._cancelled else reason
            await self._fire(Signal.CANCEL if self._cancelled else Signal.TRACKER_LOST, None)

    def _rewind(self, tick: int) -> None:
        """The character was put back to what was kept at `tick`, and so is all that was done with it since."""
        if self._at_kept is None:
            raise ConflictError("a character was put back of which nothing was kept")
        state, running = self._at_kept
        self._agenda.put_back(state.agenda)
        self._set(state, tick)
        self._running = running
        if running is not None and state.performing is not None:
            self._running = running.put_back(state.performing, self._agenda.make(running.index), tick)
        self._at_kept = state, self._running

    async def _turn(self) -> None:
        if self._machine.phase is Phase.CREATED:
            await self._act(Signal.START, self.session.state)
            return
        cycle = await self.session.cycle(self._goal)
        state = cycle.state
        self.tick, self._missed = state.tick, state.missed_ticks
        if self._running is not None:
            self._running.add(cycle.trace)
        if state.tick - self._last_report >= REPORT_TICKS:
            self._last_report = state.tick
            self._report(state)
        if self.on_cycle is not None:
            await self.on_cycle(cycle)
        # What is shown by a character that was put back was acted on before that.
        signal = None if cycle.put_back else self._signal(cycle)
        if signal is None:
            await self._keep()
        else:
            await self._act(signal, state)

    async def _act(self, signal: Signal, state: StateFrame) -> None:
        """Do all that a signal brings with it, and keep the character as it is then: what is brought back must be of
        the task that is under way. Where the tracker is lost meanwhile, nothing of it was done."""
        try:
            await self._fire(signal, state)
            self.session.keep_soon()
            await self._keep()
        except PutBackError as error:
            log.info("episode %s: %s", self.episode_id, error.message)

    async def _keep(self) -> None:
        """Keep character and tasks, if it is time. An end that cannot be kept would lack its last ticks."""
        before = self.session.kept
        await self.session.keep_if_due(last=self._machine.over and not self._cancelled)
        if self.session.kept is not before:
            self._at_kept = self.remembered(), self._running

    def _signal(self, cycle: Cycle) -> Signal | None:
        """The most important thing that the cycle showed."""
        state, phase = cycle.state, self._machine.phase
        if self._cancelled:
            self._reason = "cancelled"
            return Signal.CANCEL
        if state.tick >= self._limit_s() * TICK_HZ:
            self._reason = "the episode's time limit was reached"
            return Signal.EPISODE_TIMED_OUT
        performing = phase in (Phase.ACTING, Phase.SETTLING, Phase.DEGRADED)
        if performing and state.failure is not None:
            self._reason = state.failure
            return Signal.PHYSICS_FAILED
        running = self._running
        if running is not None and running.index in self._skips and phase in (Phase.ACTING, Phase.SETTLING):
            self._reason = "skipped"
            return Signal.TASK_FAILED if phase is Phase.ACTING else Signal.SETTLED
        trace = running.trace() if performing and running is not None else None
        watched = running is None or running.task.posture != "from_floor"
        if performing and watched and (state.fallen or (trace is not None and bool(trace.fallen.any()))):
            return Signal.FELL
        if phase is Phase.DEGRADED:
            back = cycle.planner_error is None and bool(cycle.plans)
            if not back and timed_out(self._machine, state.tick):
                self._reason = f"the planner stayed away: {cycle.planner_error}"
                return Signal.TIMED_OUT
            return Signal.PLANNER_BACK if back else None
        if performing and cycle.planner_error is not None:
            self.events.emit("planner_lost", state.tick, reason=cycle.planner_error)
            return Signal.PLANNER_LOST
        if phase is Phase.ACTING and running is not None and trace is not None:
            status = running.status()
            if status != "running":
                return Signal.TASK_DONE if status == "done" else Signal.TASK_FAILED
        elapsed = state.tick - self._machine.entered_tick
        if phase is Phase.SETTLING and elapsed > SAFE_TICKS and not (running is not None and running.leaning):
            return Signal.SETTLED
        if phase is Phase.RECOVERING and not self._down.update(view_of(state)) and elapsed >= STOOD_UP_TICKS:
            return Signal.STOOD_UP
        return Signal.TIMED_OUT if timed_out(self._machine, state.tick) else None

    async def _fire(self, signal: Signal, state: StateFrame | None) -> None:
        before = self._machine.phase
        self._machine, actions = transition(self._machine, signal, self.tick)
        if self._machine.phase is not before:
            self.events.emit("state", self.tick, before=before, after=self._machine.phase, signal=signal)
        for action in actions:
            follow_up = await self._do(action, signal, state)
            if follow_up is not None:
                await self._fire(follow_up, state)
        if self._machine.phase is Phase.ACTING and self._machine.timeout_ticks is None and self._running is not None:
            self._machine = with_limit(self._machine, self._running.task.time_limit_s)

    async def _do(self, action: Action, signal: Signal, state: StateFrame | None) -> Signal | None:
        if action is Action.CHOOSE_TASK:
            return Signal.TASK_CHOSEN if len(self._agenda) else Signal.TASKS_EXHAUSTED
        if action is Action.BEGIN_TASK and state is not None:
            await self._begin(state)
        elif action is Action.JUDGE_TASK:
            self._judge(signal)
        elif action is Action.RESET_CHARACTER:
            return await self._recover(signal)
        elif action is Action.REPLAN:
            self.events.emit("planner_back", self.tick)
            self.session.replan_now()
        elif action is Action.ABORT and self._running is not None:
            self._judge(signal)
        return None

    async def _begin(self, state: StateFrame) -> None:
        index, task = self._agenda.take()
        view = replace(view_of(state), scene=self.session.scene)
        for move in props_of(task, view):
            state = await self.session.ask(StateFrame, move)
            self.session.show(state)
            view = replace(view_of(state), scene=self.session.scene)
            self.events.emit("object_set", state.tick, name=move.name)
        self._running = Performing(index, task, view, self.session.loop.planned)
        self.session.replan_now()
        self.events.emit("task_begin", state.tick, index=index, task=task.kind, label=task.label)

    def _judge(self, signal: Signal) -> None:
        running = self._running
        if running is None:
            return
        self._running, skipped = None, running.index in self._skips
        trace = running.trace()
        verdict = running.task.judge(trace) if len(trace) else Verdict(False, False, False, False, 0.0, {})
        reason = "skipped" if skipped else None if verdict.strict else self._why_not(signal, verdict)
        if reason is not None and not skipped and not self._machine.over and self._agenda.again(running.index):
            self.events.emit("task_missed", self.tick, index=running.index, task=running.task.kind, reason=reason)
            return
        result = running.result(verdict, self._agenda.tasks[running.index].name, self.tick, reason)
        self.results.append(result)
        self.events.emit("task_end", self.tick, **result.model_dump())

    def _why_not(self, signal: Signal, verdict: Verdict) -> str:
        if verdict.fell:
            return "fell"
        if signal is Signal.TIMED_OUT:
            return "timed out"
        if signal is Signal.SETTLED:
            return "the motion does not show it"
        return self._reason or str(signal)

    async def _recover(self, signal: Signal) -> Signal | None:
        """After a fall, and again when that took too long."""
        if self.spec.on_fall == "stay":
            return Signal.STOOD_UP
        if self.spec.on_fall == "get_up" and signal is Signal.FELL and self.session.gets_up:
            self.events.emit("getting_up", self.tick)
            self.session.replan_now()
            return None
        await self.session.reset()
        return None

    def _goal(self, view: BodyView, plan_tick: int) -> PlanGoal:
        if self._running is not None:
            return self._running.goal(view, plan_tick)
        down = self.spec.on_fall == "get_up" and self._down.update(view)
        return get_up_goal() if down else PlanGoal(text=STAND_TEXT)

    def _report(self, state: StateFrame) -> None:
        x, y = (float(v) for v in state.body_pos_w_m[0, :2])
        self.events.emit(
            "progress", state.tick, phase=self._machine.phase, x_m=round(x, 3), y_m=round(y, 3),
            tracking_error_m=round(state.tracking_error_m, 4), missed_ticks=state.missed_ticks,
        )  # fmt: skip

    def _limit_s(self) -> float:
        if self.spec.time_limit_s is not None:
            return self.spec.time_limit_s
        return self._agenda.longest_s

    def _outcome(self) -> EpisodeOutcome:
        phase = self._machine.phase
        if phase is Phase.FINISHED:
            status: Literal["finished", "failed", "cancelled"] = "finished"
        elif phase is Phase.CANCELLED:
            status = "cancelled"
        elif phase is Phase.FAILED:
            status = "failed"
        else:
            raise ConflictError(f"the episode is still {phase}")
        done = len(self.results) == len(self._agenda.tasks) and all(r.success_strict for r in self.results)
        return EpisodeOutcome(
            status=status,
            reason=None if status == "finished" else self._reason,
            success=status == "finished" and done,
            results=self.results,
            ticks=self.tick,
            plans=self.session.loop.plans_made,
            missed_ticks=self._missed,
        )
