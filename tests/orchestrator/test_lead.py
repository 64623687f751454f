"""How far ahead plans are asked for: for a command as late as may be, to go on with much to spare."""

from __future__ import annotations

import pytest

from orchestrator.core.lead import COSTS, CROWDED_S, FIRST_TICKS, MOST_TICKS, ROOMY_TICKS, Asked, Effort, PlanLead

LEAST = 3


class Planner:
    """Plans by a clock of its own."""

    def __init__(self) -> None:
        self.now_s = 1000.0
        self.lead = PlanLead(lambda: self.now_s)

    def ask(self, effort: Effort = "once", roomy: bool = False) -> Asked:
        return self.lead.asked(effort, roomy)

    def plan(self, seconds: float, effort: Effort = "once", roomy: bool = False, queued_s: float = 0.0) -> None:
        asked = self.ask(effort, roomy)
        self.now_s += seconds
        self.lead.ended(asked)
        self.lead.took(asked, queued_s)

    def ticks(self, effort: Effort = "once") -> int:
        return self.lead.ticks(LEAST, effort)

    def roomy_ticks(self) -> int:
        return self.lead.roomy_ticks(LEAST)


@pytest.mark.parametrize(
    ("took_s", "ticks"),
    [
        ([], FIRST_TICKS),
        ([0.01, 0.02], LEAST),
        ([0.1, 0.1], 5),
        ([0.9], 33),
        ([0.1] * 12 + [5.0], 5),  # one that hung is no measure
        ([0.5, 1.0, 1.0, 1.2], 43),
        ([0.9, 0.1], 5),  # the planner had to warm up
        ([9.0] * 3, MOST_TICKS),
        ([9.0] * 20 + [0.1] * 20, 5),  # it has recovered
    ],
)
def test_the_lead_is_the_settings_or_what_plans_take(took_s: list[float], ticks: int) -> None:
    planner = Planner()
    for seconds in took_s:
        planner.plan(seconds)
    assert planner.ticks() == ticks


def test_blows_are_asked_for_earlier_and_do_not_delay_the_rest() -> None:
    planner = Planner()
    planner.plan(0.1)
    assert [planner.ticks(effort) for effort in COSTS] == [5, 8, 12]  # none is known: so many times the others
    planner.plan(0.2, "blow")
    assert [planner.ticks(effort) for effort in COSTS] == [5, 8, 8]


def test_what_a_plan_waited_for_others_counts_for_those_that_go_on_alone() -> None:
    planner = Planner()
    for _ in range(3):
        planner.plan(0.5, roomy=True, queued_s=0.4)
        planner.plan(0.1)
    assert planner.ticks() == 5
    assert planner.roomy_ticks() == 21  # 1.2 x 0.5 + 0.1 s


@pytest.mark.parametrize(
    ("took_s", "ticks"),
    [
        ([], ROOMY_TICKS),
        ([0.1] * 5, ROOMY_TICKS),
        ([0.1] * 5 + [0.3] + [0.1] * 50, 14),  # the longest, 0.3 s, however long ago: 1.2 x 0.3 + 0.1 s
        ([0.1] * 5 + [0.3] + [0.1] * 60, ROOMY_TICKS),
        ([0.1] * 20 + [5.0], 14),  # one that hung counts as 0.3 s
        ([0.6] * 3, 24),  # with spare up to 0.8 s
        ([0.9] * 3, 33),  # where plans take longer, as for a command
        ([9.0] * 3, MOST_TICKS),
    ],
)
def test_what_goes_on_is_asked_for_with_room_for_the_longest(took_s: list[float], ticks: int) -> None:
    planner = Planner()
    for seconds in took_s:
        planner.plan(seconds, roomy=True)
    assert planner.roomy_ticks() == ticks


def test_what_the_planner_has_still_to_make_is_waited_for() -> None:
    planner = Planner()
    for _ in range(3):
        planner.plan(0.1)
        planner.plan(0.1, roomy=True)
    assert planner.ticks() == 5
    asked = planner.ask(roomy=True)
    assert planner.ticks() == 8  # 0.14 s and all of the other, 0.1 s
    planner.now_s += 0.07
    assert planner.ticks() == 6
    planner.lead.ended(asked)
    assert planner.ticks() == 5


def test_one_batch_and_all_commands_come_first() -> None:
    planner = Planner()
    for _ in range(3):
        planner.plan(0.1)
        planner.plan(0.1, roomy=True)
    for _ in range(4):
        planner.ask(roomy=True)
    assert planner.ticks() == 8  # 0.14 s and one of 0.1 s, as three of the four wait longer than a command
    planner.ask()
    planner.ask("wave")
    assert planner.ticks() == 16  # 0.1 s and 0.18 s more


def test_one_alone_waits_for_the_longest_only_where_that_is_little() -> None:
    planner = Planner()
    for seconds in [0.07] * 20 + [0.13] + [0.07] * 20:
        planner.plan(seconds)
    assert planner.ticks() == 5  # 0.13 + 0.02 s; 1.2 x 0.07 + 0.02 s would be 4
    planner.plan(0.2)
    planner.plan(0.07)
    assert planner.ticks() == 5


def test_a_busy_planner_is_given_what_the_longest_took() -> None:
    planner = Planner()
    for seconds in [0.1] * 20 + [0.2] + [0.1] * 20:
        planner.plan(seconds)
    assert planner.ticks() == 5
    first = planner.ask(roomy=True)
    assert planner.ticks() == 8  # 0.165 s and 0.1 s: when it will be free is known
    second = planner.ask(roomy=True)
    assert planner.ticks() == 10  # 0.2 + 0.02 s and 0.1 s
    third = planner.ask(roomy=True)
    for asked in (first, second, third):
        planner.lead.ended(asked)
    assert planner.ticks() == 7  # free just now, but not alone
    planner.now_s += CROWDED_S
    assert planner.ticks() == 5


def test_a_plan_that_was_given_up_is_made_to_its_end_all_the_same() -> None:
    planner = Planner()
    planner.plan(0.1)
    planner.lead.given_up(planner.ask(roomy=True))
    assert planner.ticks() == 8
    planner.now_s += 0.2
    assert planner.ticks() == 5
