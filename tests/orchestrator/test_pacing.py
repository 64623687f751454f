"""When plans enter: a command shows soon, many commands do not tear the motion apart."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from orchestrator.core.pacing import EARLY_PLANS, EARLY_WITHIN_TICKS, LONGEST_WAIT_TICKS, PlanPacer

LEAD, LEAST = 12, 9


def test_by_hand() -> None:
    pacer = PlanPacer(LEAST)
    assert pacer.start_tick(1, 0) == 3
    pacer.entered(3, 30)
    assert pacer.start_tick(3, LEAD) == 15  # cut off early, for the first time
    pacer.entered(15, 30)
    assert pacer.start_tick(3, LEAD) == 15  # not there yet: replaced
    assert pacer.start_tick(6, LEAD) == 24  # not sooner than LEAST after the last
    pacer.entered(24, 30)
    assert pacer.start_tick(15, LEAD) == 54  # two were early: this one waits for the period
    assert pacer.start_tick(15 + EARLY_WITHIN_TICKS, LEAD) == 27 + EARLY_WITHIN_TICKS
    pacer.clear()
    assert pacer.start_tick(20, LEAD) == 33


def test_a_plan_that_only_goes_on_may_be_cut_off_at_once() -> None:
    pacer = PlanPacer(LEAST)
    pacer.entered(30, 30, goes_on=True)
    assert pacer.start_tick(30, 3) == 33
    pacer.entered(33, 30)
    assert pacer.start_tick(33, 3) == 33 + LEAST


def test_a_plan_that_only_goes_on_is_never_early() -> None:
    pacer = PlanPacer(LEAST)
    for start in (0, 27, 54, 81):
        pacer.entered(start, 30, goes_on=True)
    assert pacer.start_tick(90, 3) == 93


def test_no_one_waits_for_a_long_plan_to_end() -> None:
    pacer = PlanPacer(9)
    for start in (0, 12, 24, 36):
        pacer.entered(start, 200)
    assert pacer.start_tick(48, 0) == 36 + LONGEST_WAIT_TICKS


@given(
    moves=st.lists(st.integers(1, 20), min_size=1, max_size=150),
    period=st.sampled_from([3, 15, 30, 60]),
    lead=st.sampled_from([0, 3, 12, 24]),
)
def test_entries_keep_their_distance_and_are_never_far_off(moves: list[int], period: int, lead: int) -> None:
    pacer, now = PlanPacer(LEAST), 0
    entries: list[int] = []
    for move in moves:
        now += move
        start = pacer.start_tick(now, lead)
        pacer.entered(start, period)
        assert start % 3 == 0
        assert now + lead <= start <= max(now + lead + 2, (entries or [0])[-1] + period)
        if not entries or start != entries[-1]:
            entries.append(start)
    gaps = [b - a for a, b in zip(entries, entries[1:], strict=False)]
    assert all(gap >= min(LEAST, period) for gap in gaps)
    early = [at for at, gap in zip(entries[1:], gaps, strict=True) if gap < period]
    assert all(
        later - sooner >= EARLY_WITHIN_TICKS
        for sooner, later in zip(early, early[EARLY_PLANS:], strict=False)
    )  # fmt: skip


def test_a_command_does_not_wait_for_a_plan_that_has_still_to_go_on() -> None:
    pacer = PlanPacer(LEAST)
    pacer.entered(0, 30)
    pacer.entered(30, 30, goes_on=True)
    assert pacer.start_tick(12, 4) == 18
    pacer.entered(18, 30)  # early, as it cuts the first off; of the one in between nothing is seen
    assert pacer.remembered() == ((18, 30), (18,))
    pacer.entered(48, 30, goes_on=True)
    assert pacer.start_tick(18, 4) == 18 + LEAST  # not sooner than LEAST after the last command


def test_where_two_were_early_a_command_takes_the_place_of_what_would_go_on() -> None:
    pacer = PlanPacer(LEAST)
    for start in (0, 12, 24):
        pacer.entered(start, 90)
    pacer.entered(60, 30, goes_on=True)
    assert pacer.start_tick(40, 4) == 60  # and not when the plan of 24 ends


def test_what_takes_the_place_of_a_plan_for_a_command_is_early_once() -> None:
    pacer = PlanPacer(LEAST)
    pacer.entered(0, 30)
    pacer.entered(15, 30)
    pacer.entered(15, 30)
    assert pacer.remembered() == ((15, 30), (15,))


def test_a_plan_for_a_command_that_has_still_to_enter_is_replaced_by_one_for_the_next() -> None:
    pacer = PlanPacer(LEAST)
    pacer.entered(0, 30)
    pacer.entered(18, 30)
    pacer.entered(48, 30, goes_on=True)
    assert pacer.start_tick(12, 4) == 18
    pacer.entered(18, 30)
    assert pacer.remembered() == ((18, 30), (18,))
