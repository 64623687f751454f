"""What the planner service counts and times."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram

from shared.errors import MotionLoopError
from shared.protocol.messages import Plan
from shared.telemetry import SECONDS, MetricsEndpoint, Recent

BATCHES = (1, 2, 3, 4, 6, 8, 12, 16, 32, 64, 128, 256)


class PlannerMetrics:
    """Numbers of one planner service.

    Args:
        pending: tells how many requests are admitted and not yet answered.
    """

    def __init__(self, pending: Callable[[], float]):
        by_planner = ("planner",)
        of = CollectorRegistry()
        self.endpoint = MetricsEndpoint(of)
        self._plan_s = Histogram(
            "motionloop_planner_plan_seconds", "Computing one batch of plans", by_planner, buckets=SECONDS, registry=of
        )
        self._queue_s = Histogram(
            "motionloop_planner_queue_seconds",
            "A request waits for its batch",
            by_planner,
            buckets=SECONDS,
            registry=of,
        )
        self._batch = Histogram(
            "motionloop_planner_batch_size", "Requests planned together", by_planner, buckets=BATCHES, registry=of
        )
        self._outcomes = Counter(
            "motionloop_planner_requests", "Requests by what became of them: plan, or the error's code",
            (*by_planner, "outcome"), registry=of,
        )  # fmt: skip
        Gauge("motionloop_planner_pending", "Requests admitted and not yet answered", registry=of).set_function(pending)
        self._recent: dict[str, tuple[Recent, Recent]] = {}

    def planned(self, name: str, wall_s: float, waited_s: Sequence[float], outcomes: Sequence[object]) -> None:
        """Take in a batch of planner `name`: its wall time, how long each request waited, each plan or error."""
        self._plan_s.labels(name).observe(wall_s)
        self._batch.labels(name).observe(len(outcomes))
        for waited in waited_s:
            self._queue_s.labels(name).observe(waited)
        for outcome in outcomes:
            self._outcomes.labels(name, outcome_name(outcome)).inc()
        plan_ms, queue_ms = self._recent.setdefault(name, (Recent(), Recent()))
        plan_ms.add([wall_s * 1e3])
        queue_ms.add(waited * 1e3 for waited in waited_s)

    def expired(self, name: str) -> None:
        """Take in a request that was dropped because its deadline had passed."""
        self._outcomes.labels(name, "deadline_exceeded").inc()

    def detail(self) -> dict[str, float | int | str]:
        """Of the last batches, for the service's report of its health: medians and 95th percentiles in ms."""
        said: dict[str, float | int | str] = {}
        for name, (plan_ms, queue_ms) in list(self._recent.items()):
            said[f"{name}.plan_ms"] = round(plan_ms.quantile(0.5), 2)
            said[f"{name}.plan_ms_p95"] = round(plan_ms.quantile(0.95), 2)
            said[f"{name}.queue_ms_p95"] = round(queue_ms.quantile(0.95), 2)
        return said


def outcome_name(outcome: object) -> str:
    """`plan`, or the code of an error."""
    if isinstance(outcome, Plan):
        return "plan"
    return outcome.code if isinstance(outcome, MotionLoopError) else "internal"
