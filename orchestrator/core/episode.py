"""An episode: tasks one after another on one character, driven by the state machine."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import asdict, replace
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from orchestrator.core.agenda import Agenda
from orchestrator.core.drivers import Cycle
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
from orchestrator.core.on_fall import Down, OnFall, get_up_goal
from orchestrator.core.performing import Performing
from orchestrator.core.scenes import SceneChoice
from orchestrator.core.services import Services
from orchestrator.core.session import Session
from orchestrator.core.settings import LoopSettings
from orchestrator.rest import TaskResult
from shared.errors import ConflictError, MotionLoopError, NotFoundError, TransportError
from shared.protocol.base import Name
from shared.protocol.messages import TICK_HZ, Pacing, Seed, SetObject, StateFrame
from shared.tasks.factory import TaskSpec
from shared.tasks.interface import BodyView, PlanGoal, Trace, Verdict
from shared.tasks.rules import SAFE_TICKS
from shared.tasks.specs import TimeLimit
from shared.text.wording import STAND_TEXT

STOOD_UP_TICKS = 15
REPORT_TICKS = 15


class EpisodeSpec(BaseModel):
    """What to do, with what, and how.

    Attributes:
        order: `random` shuffles the tasks by the seed.
        on_fall: after a fall the task has failed, and the character is put on its feet, gets up (and is put on its feet
            where it does not manage to), or stays down for the tasks that follow.
        loop: settings of the loop; None for the defaults of the pacing.
        time_limit_s: simulated seconds for all tasks together; None for the sum of theirs.
        heading_rad: which way the character faces at the start.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")
    name: Annotated[str, Field(max_length=80)] | None = None
    character: Name = "human"
    scene: SceneChoice = "flat"
    tasks: Annotated[list[TaskSpec], Field(min_length=1, max_length=200)]
    order: Literal["sequence", "random"] = "sequence"
    seed: Seed = 0
    pacing: Pacing = "lockstep"
    time_limit_s: TimeLimit | None = None
    planner: Name | None = None
    tracker: Name | None = None
    loop: LoopSettings | None = None
    on_fall: OnFall = "reset"
    heading_rad: Annotated[FiniteFloat, Field(ge=-100, le=100)] = 0.0


class EpisodeOutcome(BaseModel):
    """How the episode ended."""

    model_config = ConfigDict(frozen=True)
    status: Literal["finished", "failed", "cancelled"]
    reason: str | None
    success: bool
    results: list[TaskResult]
    ticks: int
    plans: int
    missed_ticks: int


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
        self.session.on_rewind = self._rewind
        self._on_cycle = on_cycle
        self._agenda = Agenda(spec.tasks, spec.order, spec.seed)
        self._machine = MachineState()
        self._running: Performing | None = None
        self._resume_from: Keepsake | None = None
        self._skipped = False
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
        self._skipped = True
        return self._running.index

    def insert(self, task: TaskSpec, place: int) -> int:
        """Add a task before what is `place`-th to come; returns its index. Raises ConflictError when it is over."""
        if self._machine.over:
            raise ConflictError(f"the episode is {self.phase}", field="id")
        task.check(self.session.scene)
        index = self._agenda.insert(task, place)
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
        )

    def take_up(self, state: EpisodeState, kept: Keepsake, trace: Trace) -> None:
        """Let `run` go on with an episode of an earlier process, instead of beginning one.

        Args:
            state, kept: as that process wrote them.
            trace: what had happened by then, from tick 0.
        """
        self.tick, self._missed, self._last_report = kept.tick, state.missed_ticks, state.last_report
        self._machine = MachineState(**state.machine.model_dump())
        self._agenda.remember(state.agenda)
        self.results, self._down.is_so = list(state.results), state.down
        if (doing := state.performing) is not None:
            task, scene = self._agenda.make(doing.index), self.session.choose_scene()
            since = trace.since(doing.begin_tick)
            self._running = Performing.again(doing, task, since, self.spec.character, scene)
        self._resume_from = kept

    async def run(self) -> EpisodeOutcome:
        """Create the character, perform the tasks, say how it went. Never raises for what services do."""
        try:
            if self._resume_from is None:
                await self._fire(Signal.START, await self.session.start())
                await self.session.keep_if_due()
            else:
                await self.session.take_up(self._resume_from)
                self.events.emit("resumed", self._resume_from.tick, phase=self._machine.phase)
            while not self._machine.over:
                await self._turn()
        except (TransportError, NotFoundError) as error:
            self._reason = "cancelled" if self._cancelled else f"the tracker is gone: {error.message}"
            await self._fire(Signal.CANCEL if self._cancelled else Signal.TRACKER_LOST, None)
        except MotionLoopError as error:
            self._reason = error.message
            await self._fire(Signal.TRACKER_LOST, None)
        finally:
            await self.session.stop()
        return self._outcome()

    def _rewind(self, tick: int) -> None:
        """The character was put back to `tick`: what was seen of it after that has not happened."""
        self.tick = tick
        if self._running is not None:
            self._running.forget_after(tick)

    async def _turn(self) -> None:
        cycle = await self.session.cycle(self._goal)
        state = cycle.state
        self.tick, self._missed = state.tick, state.missed_ticks
        if self._running is not None:
            self._running.add(cycle.trace)
        if state.tick - self._last_report >= REPORT_TICKS:
            self._last_report = state.tick
            self._report(state)
        if self._on_cycle is not None:
            await self._on_cycle(cycle)
        signal = self._signal(cycle)
        if signal is not None:
            await self._fire(signal, state)
            self.session.keep_soon()  # what is brought back must be of the task that is under way
        await self.session.keep_if_due()

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
        if self._skipped and running is not None and phase in (Phase.ACTING, Phase.SETTLING):
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
            status = running.task.status(trace)
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
        for name, pose in task.props(view).items():
            x, y, z, *quat = (float(v) for v in pose)
            still = (0.0, 0.0, 0.0)
            move = SetObject(
                name=name, position_w_m=(x, y, z), quat_w=(quat[0], quat[1], quat[2], quat[3]),
                linvel_w_mps=still, angvel_w_radps=still,
            )  # fmt: skip
            state = await self.session.ask(StateFrame, move)
            view = replace(view_of(state), scene=self.session.scene)
            self.events.emit("object_set", state.tick, name=name)
        task.start(view)
        self._running = Performing(index, task, state.tick)
        self.session.replan_now()
        self.events.emit("task_begin", state.tick, index=index, task=task.kind, label=task.label)

    def _judge(self, signal: Signal) -> None:
        running = self._running
        if running is None:
            return
        self._running, skipped, self._skipped = None, self._skipped, False
        trace = running.trace()
        verdict = running.task.judge(trace) if len(trace) else Verdict(False, False, False, False, 0.0, {})
        reason = "skipped" if skipped else None if verdict.strict else self._why_not(signal, verdict)
        if reason is not None and not skipped and not self._machine.over and self._agenda.again(running.index):
            self.events.emit("task_missed", self.tick, index=running.index, task=running.task.kind, reason=reason)
            return
        spec = self._agenda.tasks[running.index]
        result = TaskResult(
            index=running.index,
            name=spec.name or running.task.label,
            type=running.task.kind,
            label=running.task.label,
            success_strict=verdict.strict and not skipped,
            success_paper=verdict.paper,
            success_code=verdict.code,
            fell=verdict.fell,
            seconds=round(verdict.seconds, 3),
            start_tick=running.begin_tick,
            stop_tick=self.tick,
            reason=reason,
            measures={name: round(value, 4) for name, value in verdict.measures.items()},
        )
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
        if self.spec.on_fall == "get_up" and signal is Signal.FELL:
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
