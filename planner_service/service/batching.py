"""Collecting the requests of many characters into batches for one planner."""

from __future__ import annotations

import logging
import queue
import threading
import time
from concurrent.futures import Future
from dataclasses import dataclass

from planner_service.service.metrics import PlannerMetrics
from shared.errors import DeadlineError, MotionLoopError, UnavailableError
from shared.plugins.checks import check_plan, ignored_conditions
from shared.plugins.interfaces import Planner
from shared.protocol.base import Message
from shared.protocol.messages import Plan, PlanRequest

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class _Waiting:
    request: PlanRequest
    deadline_unix_s: float | None
    future: Future[Message]
    since: float


class Batcher:
    """A thread that plans. Expired requests are dropped; one that fails does not spoil the others in its batch.

    Args:
        planner: used by this thread only.
        max_batch: requests planned together.
        max_wait_s: how long the first of a batch waits for others.
        metrics: told of every batch.
    """

    def __init__(self, planner: Planner, max_batch: int, max_wait_s: float, metrics: PlannerMetrics):
        self._planner = planner
        self._max_batch = max_batch
        self._max_wait_s = max_wait_s
        self._metrics = metrics
        self._queue: queue.SimpleQueue[_Waiting | None] = queue.SimpleQueue()
        self._closed = False
        self.plans_made = 0
        self.batches_made = 0
        self._thread = threading.Thread(target=self._run, name=f"planner-{planner.spec.name}", daemon=True)
        self._thread.start()

    def submit(self, request: PlanRequest, deadline_unix_s: float | None) -> Future[Message]:
        """The plan to come."""
        future: Future[Message] = Future()
        if self._closed:
            future.set_exception(UnavailableError("the planner is shutting down"))
        else:
            self._queue.put(_Waiting(request, deadline_unix_s, future, time.monotonic()))
        return future

    def close(self) -> None:
        """Finish the batch at hand, refuse the rest, end the thread."""
        self._closed = True
        self._queue.put(None)
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
        while not self._queue.empty():
            left = self._queue.get()
            if left is not None:
                left.future.set_exception(UnavailableError("the planner is shutting down"))

    def _collect(self) -> list[_Waiting] | None:
        """The next batch; None when closed."""
        first = self._queue.get()
        if first is None:
            return None
        batch = [first]
        until = time.monotonic() + self._max_wait_s
        while len(batch) < self._max_batch:
            try:
                item = self._queue.get(timeout=max(0.0, until - time.monotonic()))
            except queue.Empty:
                break
            if item is None:
                self._queue.put(None)
                break
            batch.append(item)
        return batch

    def _answer(self, batch: list[_Waiting]) -> None:
        started = time.monotonic()
        requests = [item.request for item in batch]
        outcomes: list[Plan | MotionLoopError] = list(self._plan_all(requests))
        wall_ms = (time.monotonic() - started) * 1e3
        self.batches_made += 1
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
