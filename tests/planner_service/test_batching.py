"""What a planner is given first, and how much at once."""

from __future__ import annotations

import threading
from collections.abc import Sequence

import pytest

from planner_service.builtin.stand import StandPlanner
from planner_service.service.batching import BY_CLOCK_BATCH_S, BY_CLOCK_FOR_S, Batcher
from planner_service.service.metrics import PlannerMetrics
from shared.plugins.conformance import sample_request
from shared.protocol.messages import Plan, PlanRequest

PLAN_S = BY_CLOCK_BATCH_S / 2.2
"""So two plans fit into a batch while there are characters by the clock."""
GIVE_UP_S = 20.0


class Slow:
    """A real planner (`stand`) by a clock of its own, whose first batch waits until the others are there."""

    def __init__(self) -> None:
        self.spec = StandPlanner().spec
        self.entered, self.go_on = threading.Event(), threading.Event()
        self.batches: list[list[int]] = []
        self.now_s = 100.0

    def plan(self, requests: list[PlanRequest]) -> list[Plan]:
        self.entered.set()
        assert self.go_on.wait(GIVE_UP_S)
        self.batches.append([request.seed for request in requests])
        self.now_s += PLAN_S * len(requests)
        return StandPlanner().plan(requests)


def asked(planner: Slow, seed: int, ahead_frames: int) -> PlanRequest:
    request: PlanRequest = sample_request(planner.spec, seed=seed)
    return request.model_copy(update={"context_frames": ahead_frames})


def batches(ahead_frames: Sequence[int], max_batch: int = 8, later_s: float = 0.0) -> list[list[int]]:
    """Seeds by batch: 0 is asked for first, and while it is planned 1, 2, ... in this order, each so far ahead."""
    planner = Slow()
    batcher = Batcher(planner, max_batch, 0.0, PlannerMetrics(lambda: 0.0), now=lambda: planner.now_s)
    try:
        futures = [batcher.submit(asked(planner, 0, ahead_frames[0]), None)]
        assert planner.entered.wait(GIVE_UP_S)
        planner.now_s += later_s
        futures += [batcher.submit(asked(planner, n, ahead), None) for n, ahead in enumerate(ahead_frames) if n]
        planner.go_on.set()
        for future in futures:
            future.result(GIVE_UP_S)
    finally:
        planner.go_on.set()
        batcher.close()
    return planner.batches


def test_what_is_due_first_is_planned_first() -> None:
    assert batches([10, 16, 10, 3, 0, 3], max_batch=1) == [[0], [3], [5], [2], [1], [4]]


def test_those_who_let_no_time_pass_are_planned_for_together() -> None:
    assert batches([0] * 9) == [[0], [1, 2, 3, 4, 5, 6, 7, 8]]


def test_by_the_clock_no_one_waits_for_a_long_batch() -> None:
    assert batches([20] * 6) == [[0], [1, 2], [3, 4], [5]]
    assert batches([20, 20, 20, 0, 0]) == [[0], [1, 2], [3, 4]]  # nor do they because of those in no hurry


def test_nothing_is_planned_with_what_leaves_no_time_for_it() -> None:
    hurried = round(PLAN_S * 2.5 * StandPlanner().spec.fps)  # enough for itself; half of it is not for two
    assert batches([20, 20, 20, hurried]) == [[0], [3], [1, 2]]


@pytest.mark.parametrize(("later_s", "together"), [(0.0, [2, 2]), (BY_CLOCK_FOR_S * 1.1, [4])])
def test_batches_are_as_long_as_may_be_once_no_one_goes_by_the_clock(later_s: float, together: list[int]) -> None:
    assert [len(batch) for batch in batches([20, 0, 0, 0, 0], later_s=later_s)] == [1, *together]
