"""The transition table: every path ends, time-outs retry and then fall back, the diagram is current."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.core import diagram
from orchestrator.core.machine import (
    STATES,
    TERMINAL,
    TRANSITIONS,
    Action,
    MachineState,
    Phase,
    Signal,
    StateSpec,
    timed_out,
    transition,
    with_limit,
)
from shared.errors import ConflictError


def run(*signals: Signal) -> tuple[MachineState, list[Action]]:
    state = MachineState()
    done: list[Action] = []
    for tick, signal in enumerate(signals):
        state, actions = transition(state, signal, tick)
        done += actions
    return state, done


def test_a_task_that_succeeds() -> None:
    state, actions = run(
        Signal.START, Signal.TASK_CHOSEN, Signal.TASK_DONE, Signal.SETTLED, Signal.TASKS_EXHAUSTED
    )  # fmt: skip
    assert state.phase is Phase.FINISHED
    assert state.over
    assert actions == [
        Action.CHOOSE_TASK, Action.BEGIN_TASK, Action.JUDGE_TASK, Action.CHOOSE_TASK, Action.FINISH,
    ]  # fmt: skip


def test_a_fall_is_judged_before_the_character_is_stood_up() -> None:
    state, actions = run(Signal.START, Signal.TASK_CHOSEN, Signal.FELL)
    assert state.phase is Phase.RECOVERING
    assert actions[-2:] == [Action.JUDGE_TASK, Action.RESET_CHARACTER]
    state, following = transition(state, Signal.STOOD_UP, 9)
    assert (state.phase, following) == (Phase.CHOOSING, (Action.CHOOSE_TASK,))


def test_an_outage_of_the_planner_goes_back_to_the_task() -> None:
    state, _ = run(Signal.START, Signal.TASK_CHOSEN, Signal.PLANNER_LOST)
    assert state.phase is Phase.DEGRADED
    state, actions = transition(state, Signal.PLANNER_BACK, 5)
    assert (state.phase, actions) == (Phase.ACTING, (Action.REPLAN,))


def test_time_outs_retry_and_then_fall_back() -> None:
    state, _ = run(Signal.START, Signal.TASK_CHOSEN, Signal.FELL)
    assert not timed_out(state, 2 + 239)
    assert timed_out(state, 2 + 240)
    state, actions = transition(state, Signal.TIMED_OUT, 152)
    assert (state.phase, state.retries_used, actions) == (Phase.RECOVERING, 1, (Action.RESET_CHARACTER,))
    state, actions = transition(state, Signal.TIMED_OUT, 302)
    assert (state.phase, actions) == (Phase.FAILED, (Action.ABORT,))


def test_a_task_brings_its_own_limit() -> None:
    state, _ = run(Signal.START, Signal.TASK_CHOSEN)
    assert not timed_out(state, 10**6)
    state = with_limit(state, 4.0)
    assert not timed_out(state, 1 + 119)
    assert timed_out(state, 1 + 120)
    state, actions = transition(state, Signal.TIMED_OUT, 121)
    assert (state.phase, actions) == (Phase.CHOOSING, (Action.JUDGE_TASK, Action.CHOOSE_TASK))


def test_retries_of_a_state_are_a_setting() -> None:
    states = {**STATES, Phase.ACTING: StateSpec(1.0, 1, Phase.CHOOSING, (), (Action.BEGIN_TASK,))}
    state, _ = run(Signal.START, Signal.TASK_CHOSEN)
    state, actions = transition(state, Signal.TIMED_OUT, 30, states)
    assert (state.phase, actions) == (Phase.ACTING, (Action.BEGIN_TASK,))
    assert transition(state, Signal.TIMED_OUT, 60, states)[0].phase is Phase.CHOOSING


def test_an_unknown_signal_names_the_known_ones() -> None:
    with pytest.raises(ConflictError, match="settled means nothing while created") as caught:
        transition(MachineState(), Signal.SETTLED, 0)
    assert caught.value.allowed is not None
    assert "start" in caught.value.allowed


@pytest.mark.parametrize("phase", [p for p in Phase if p not in TERMINAL])
def test_every_state_can_be_cancelled_and_survives_the_loss_of_the_tracker(phase: Phase) -> None:
    state = MachineState(phase)
    assert transition(state, Signal.CANCEL, 0)[0].phase is Phase.CANCELLED
    assert transition(state, Signal.TRACKER_LOST, 0)[0].phase is Phase.FAILED
    assert phase in STATES


@given(st.lists(st.sampled_from(sorted(Signal)), max_size=40))
def test_any_signals_keep_the_machine_in_the_table(signals: list[Signal]) -> None:
    """Unknown signals are refused and change nothing; a finished machine stays finished."""
    state = MachineState()
    for tick, signal in enumerate(signals):
        known = signal is Signal.TIMED_OUT or (state.phase, signal) in TRANSITIONS
        if not (known or state.over):
            with pytest.raises(ConflictError):
                transition(state, signal, tick)
            continue
        before = state
        state, actions = transition(state, signal, tick)
        if before.over:
            assert state == before
            assert actions == ()


def test_the_diagram_in_the_docs_is_current() -> None:
    assert diagram.PATH.read_text() == diagram.render(), "run: python -m orchestrator.core.diagram"
