"""Collecting the requests of many characters into batches for one planner: what is due first is planned first."""

from __future__ import annotations

import heapq
import logging
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from itertools import count
from math import inf

from planner_service.service.metrics import PlannerMetrics
from shared.errors import DeadlineError, MotionLoopError, UnavailableError
from shared.plugins.checks import check_plan, ignored_conditions
from shared.plugins.interfaces import Planner
from shared.protocol.base import Message
from shared.protocol.messages import Plan, PlanRequest

log = logging.getLogger(__name__)

UNHURRIED_S = 1.0
"""When a request is due whose plan starts from the present state: whoever asks lets no time pass until it comes."""
BY_CLOCK_BATCH_S = 0.2
"""Planning together saves a processor a tenth or two, but who comes meanwhile waits for the whole batch: while there
are characters by the clock, no more are planned together than are likely done in this time, and in half of that which
is left for the first of them."""
BY_CLOCK_FOR_S = 5.0
_NEWEST = 0.2
"""How much the newest batch counts in what a plan takes."""


@dataclass(frozen=True)
class _Waiting:
    request: PlanRequest
    deadline_unix_s: float | None
    future: Future[Message]
    since: float

    @property
    def due(self) -> float:
        """When the plan should be there: as far ahead of its start as it was asked for, seconds of the monotonic clock.
        The frames of the prefix after the present say how far that is."""
        ahead_s = self.request.context_frames / self.request.fps
        return self.since + (ahead_s or UNHURRIED_S)


class Batcher:
    """A thread that plans. Expired requests are dropped; one that fails does not spoil the others in its batch.

    What is due first comes first (Liu & Layland 1973), so that a command does not wait for plans of other characters
    that only go on and were asked for long before they start.

    Args:
        planner: used by this thread only.
        max_batch: requests planned together.
        max_wait_s: how long the first of a batch waits for others.
        metrics: told of every batch.
        now: monotonic seconds.
    """

    def __init__(
        self,
        planner: Planner,
        max_batch: int,
        max_wait_s: float,
        metrics: PlannerMetrics,
        now: Callable[[], float] = time.monotonic,
    ):
        self._planner = planner
        self._max_batch = max_batch
        self._max_wait_s = max_wait_s
        self._metrics = metrics
        self._now = now
        self._changed = threading.Condition()
        self._waiting: list[tuple[float, int, _Waiting]] = []  # a heap, by when it is due
        self._numbers = count()
        self._closed = False
        self._plan_s = 0.0
        self._by_clock_until = -inf
        self.plans_made = 0
        self.batches_made = 0
        self._thread = threading.Thread(target=self._run, name=f"planner-{planner.spec.name}", daemon=True)
        self._thread.start()

    def submit(self, request: PlanRequest, deadline_unix_s: float | None) -> Future[Message]:
        """The plan to come."""
        future: Future[Message] = Future()
        item = _Waiting(request, deadline_unix_s, future, self._now())
        with self._changed:
            if self._closed:
                future.set_exception(UnavailableError("the planner is shutting down"))
                return future
            if request.context_frames:
                self._by_clock_until = item.since + BY_CLOCK_FOR_S
            heapq.heappush(self._waiting, (item.due, next(self._numbers), item))
            self._changed.notify()
        return future

    def close(self) -> None:
        """Finish the batch at hand, refuse the rest, end the thread."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        self._thread.join()

    def _run(self) -> None:
        while (batch := self._collect()) is not None:
            now = time.time()
            fresh = []
            for item in batch:
                if item.deadline_unix_s is not None and now > item.deadline_unix_s:
                    item.future.set_exception(DeadlineError("the request expired while it waited for the planner"))
                    self._metrics.expired(self._planner.spec.name)
                else:
                    fresh.append(item)
            if fresh:
                self._answer(fresh)
        for _, _, left in self._waiting:
            left.future.set_exception(UnavailableError("the planner is shutting down"))

    def _collect(self) -> list[_Waiting] | None:
        """The next batch; None when closed."""
        with self._changed:
            while not self._waiting and not self._closed:
                self._changed.wait()
            until = self._now() + self._max_wait_s
            while not self._closed and len(self._waiting) < self._most_together():
                left_s = until - self._now()
                if left_s <= 0:
                    break
                self._changed.wait(left_s)
            if self._closed:
                return None
            size = min(self._most_together(), len(self._waiting))
            return [heapq.heappop(self._waiting)[2] for _ in range(size)]

    def _most_together(self) -> int:
        """How many may be planned with what is due first."""
        now = self._now()
        if now > self._by_clock_until or self._plan_s <= 0:
            return self._max_batch
        time_s = min(BY_CLOCK_BATCH_S, (self._waiting[0][0] - now) / 2)
        return max(1, min(self._max_batch, int(time_s / self._plan_s)))

    def _answer(self, batch: list[_Waiting]) -> None:
        started = self._now()
        requests = [item.request for item in batch]
        outcomes: list[Plan | MotionLoopError] = list(self._plan_all(requests))
        wall_ms = (self._now() - started) * 1e3
        self.batches_made += 1
        share_s = wall_ms / 1e3 / len(batch)
        self._plan_s = share_s if self.batches_made == 1 else self._plan_s + _NEWEST * (share_s - self._plan_s)
        waited_s = [started - item.since for item in batch]
        self._metrics.planned(self._planner.spec.name, wall_ms / 1e3, waited_s, outcomes)
        for item, outcome in zip(batch, outcomes, strict=True):
            if isinstance(outcome, MotionLoopError):
                item.future.set_exception(outcome)
                continue
            self.plans_made += 1
            timings = {
                **outcome.timings_ms,
                "queue": (started - item.since) * 1e3,
                "plan": wall_ms,
                "batch": float(len(batch)),
            }
            ignored = list(
                dict.fromkeys((*ignored_conditions(item.request, self._planner.spec), *outcome.ignored_conditions))
            )
            item.future.set_result(outcome.model_copy(update={"timings_ms": timings, "ignored_conditions": ignored}))

    def _plan_all(self, requests: list[PlanRequest]) -> list[Plan | MotionLoopError]:
        """Plans or errors, in order; when the batch fails as a whole, each request is tried alone."""
        try:
            plans = self._planner.plan(requests)
            if len(plans) != len(requests):
                raise MotionLoopError(f"{self._planner.spec.name} gave {len(plans)} plans for {len(requests)} requests")
        except (Exception, SystemExit) as error:  # a plug-in may raise anything; the senders must get a reply
            if len(requests) > 1:
                return [outcome for request in requests for outcome in self._plan_all([request])]
            if isinstance(error, MotionLoopError):
                return [error]
            log.error("%s failed", self._planner.spec.name, exc_info=error)
            return [MotionLoopError(f"planner {self._planner.spec.name!r} failed: {type(error).__name__}: {error}")]
        return [self._checked(request, plan) for request, plan in zip(requests, plans, strict=True)]

    def _checked(self, request: PlanRequest, plan: Plan) -> Plan | MotionLoopError:
        try:
            check_plan(request, plan)
        except MotionLoopError as error:
            return error
        except Exception as error:  # a plug-in may give anything too: this thread must outlive what is no plan at all
            log.error("%s gave no plan", self._planner.spec.name, exc_info=error)
            return MotionLoopError(f"planner {self._planner.spec.name!r} gave no plan: {type(error).__name__}: {error}")
        return plan
