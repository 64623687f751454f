"""The state machine of an episode: a pure function from (state, event) to (state, actions) over a table.

Nothing here waits, talks or knows a service. The runner feeds events (a task is done, the character fell, the planner
is away, the tick is now ...) and carries out the actions that come back. `python -m orchestrator.core.diagram` draws
the table.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum

from shared.errors import ConflictError
from shared.protocol.rates import TICK_HZ


class Phase(StrEnum):
    """Where an episode is."""

    CREATED = "created"
    CHOOSING = "choosing"
    ACTING = "acting"
    SETTLING = "settling"
    RECOVERING = "recovering"
    DEGRADED = "degraded"
    FINISHED = "finished"
    FAILED = "failed"
    CANCELLED = "cancelled"


class Signal(StrEnum):
    """What can happen."""

    START = "start"
    TASK_CHOSEN = "task_chosen"
    TASKS_EXHAUSTED = "tasks_exhausted"
    TASK_DONE = "task_done"
    TASK_FAILED = "task_failed"
    FELL = "fell"
    SETTLED = "settled"
    STOOD_UP = "stood_up"
    PLANNER_LOST = "planner_lost"
    PLANNER_BACK = "planner_back"
    TRACKER_LOST = "tracker_lost"
    PHYSICS_FAILED = "physics_failed"
    EPISODE_TIMED_OUT = "episode_timed_out"
    CANCEL = "cancel"
    TIMED_OUT = "timed_out"


class Action(StrEnum):
    """What the runner has to do."""

    CHOOSE_TASK = "choose_task"
    BEGIN_TASK = "begin_task"
    JUDGE_TASK = "judge_task"
    RESET_CHARACTER = "reset_character"
    REPLAN = "replan"
    FINISH = "finish"
    ABORT = "abort"


TERMINAL = frozenset({Phase.FINISHED, Phase.FAILED, Phase.CANCELLED})


@dataclass(frozen=True)
class StateSpec:
    """Time-out, retries and fallback of a state.

    Attributes:
        timeout_s: simulated seconds in the state after which `timed_out` happens by itself; None for never. A task
            that is being performed brings its own limit instead.
        retries: how often a time-out starts the state anew (with `retry_actions`) before the fallback is taken.
        fallback, fallback_actions: where a time-out leads when no retry is left.
    """

    timeout_s: float | None
    retries: int
    fallback: Phase
    fallback_actions: tuple[Action, ...] = ()
    retry_actions: tuple[Action, ...] = ()


STATES: Mapping[Phase, StateSpec] = {
    Phase.CREATED: StateSpec(10.0, 0, Phase.FAILED, (Action.ABORT,)),
    Phase.CHOOSING: StateSpec(10.0, 0, Phase.FAILED, (Action.ABORT,)),
    Phase.ACTING: StateSpec(None, 0, Phase.CHOOSING, (Action.JUDGE_TASK, Action.CHOOSE_TASK), (Action.BEGIN_TASK,)),
    Phase.SETTLING: StateSpec(5.0, 0, Phase.CHOOSING, (Action.JUDGE_TASK, Action.CHOOSE_TASK)),
    Phase.RECOVERING: StateSpec(8.0, 1, Phase.FAILED, (Action.ABORT,), (Action.RESET_CHARACTER,)),
    Phase.DEGRADED: StateSpec(60.0, 0, Phase.FAILED, (Action.JUDGE_TASK, Action.ABORT)),
}

Key = tuple[Phase, Signal]
_JUDGE_NEXT = (Action.JUDGE_TASK, Action.CHOOSE_TASK)
_JUDGE_RESET = (Action.JUDGE_TASK, Action.RESET_CHARACTER)

TRANSITIONS: Mapping[Key, tuple[Phase, tuple[Action, ...]]] = {
    (Phase.CREATED, Signal.START): (Phase.CHOOSING, (Action.CHOOSE_TASK,)),
    (Phase.CHOOSING, Signal.TASK_CHOSEN): (Phase.ACTING, (Action.BEGIN_TASK,)),
    (Phase.CHOOSING, Signal.TASKS_EXHAUSTED): (Phase.FINISHED, (Action.FINISH,)),
    (Phase.ACTING, Signal.TASK_DONE): (Phase.SETTLING, ()),
    (Phase.ACTING, Signal.TASK_FAILED): (Phase.CHOOSING, _JUDGE_NEXT),
    (Phase.ACTING, Signal.FELL): (Phase.RECOVERING, _JUDGE_RESET),
    (Phase.ACTING, Signal.PHYSICS_FAILED): (Phase.FAILED, (Action.JUDGE_TASK, Action.ABORT)),
    (Phase.ACTING, Signal.PLANNER_LOST): (Phase.DEGRADED, ()),
    (Phase.SETTLING, Signal.SETTLED): (Phase.CHOOSING, _JUDGE_NEXT),
    (Phase.SETTLING, Signal.FELL): (Phase.RECOVERING, _JUDGE_RESET),
    (Phase.SETTLING, Signal.PHYSICS_FAILED): (Phase.FAILED, (Action.JUDGE_TASK, Action.ABORT)),
    (Phase.SETTLING, Signal.PLANNER_LOST): (Phase.DEGRADED, ()),
    (Phase.RECOVERING, Signal.STOOD_UP): (Phase.CHOOSING, (Action.CHOOSE_TASK,)),
    (Phase.DEGRADED, Signal.PLANNER_BACK): (Phase.ACTING, (Action.REPLAN,)),
    (Phase.DEGRADED, Signal.FELL): (Phase.RECOVERING, _JUDGE_RESET),
    (Phase.DEGRADED, Signal.PHYSICS_FAILED): (Phase.FAILED, (Action.JUDGE_TASK, Action.ABORT)),
    **{
        (phase, signal): (target, actions)
        for phase in (
            Phase.CREATED, Phase.CHOOSING, Phase.ACTING, Phase.SETTLING, Phase.RECOVERING, Phase.DEGRADED,
        )
        for signal, target, actions in (
            (Signal.CANCEL, Phase.CANCELLED, (Action.ABORT,)),
            (Signal.TRACKER_LOST, Phase.FAILED, (Action.ABORT,)),
            (Signal.EPISODE_TIMED_OUT, Phase.FAILED, (Action.JUDGE_TASK, Action.ABORT)),
        )
    },
}  # fmt: skip


@dataclass(frozen=True)
class MachineState:
    """Phase, since when (tick), the limit in force, and the time-outs already used up in this phase."""

    phase: Phase = Phase.CREATED
    entered_tick: int = 0
    timeout_ticks: int | None = None
    retries_used: int = 0

    @property
    def over(self) -> bool:
        """Whether the episode has ended."""
        return self.phase in TERMINAL


def transition(
    state: MachineState, signal: Signal, tick: int, states: Mapping[Phase, StateSpec] = STATES, tick_hz: int = TICK_HZ
) -> tuple[MachineState, tuple[Action, ...]]:
    """The next state and what to do. Raises ConflictError for a signal that the phase does not know."""
    if state.over:
        return state, ()
    if signal is Signal.TIMED_OUT:
        spec = states[state.phase]
        if state.retries_used < spec.retries:
            return replace(state, entered_tick=tick, retries_used=state.retries_used + 1), spec.retry_actions
        return _enter(spec.fallback, tick, states, tick_hz), spec.fallback_actions
    found = TRANSITIONS.get((state.phase, signal))
    if found is None:
        known = ", ".join(str(s) for p, s in TRANSITIONS if p is state.phase)
        raise ConflictError(f"{signal} means nothing while {state.phase}", field="signal", allowed=known)
    target, actions = found
    return _enter(target, tick, states, tick_hz), actions


def _enter(phase: Phase, tick: int, states: Mapping[Phase, StateSpec], tick_hz: int) -> MachineState:
    timeout_s = states[phase].timeout_s if phase in states else None
    return MachineState(phase, tick, None if timeout_s is None else round(timeout_s * tick_hz))


def with_limit(state: MachineState, limit_s: float, tick_hz: int = TICK_HZ) -> MachineState:
    """The same state under a task's own time limit."""
    return replace(state, timeout_ticks=round(limit_s * tick_hz))


def timed_out(state: MachineState, tick: int) -> bool:
    """Whether the phase has lasted longer than allowed at `tick`."""
    return not state.over and state.timeout_ticks is not None and tick - state.entered_tick >= state.timeout_ticks
