"""What the orchestrator counts for Prometheus: gauges read when asked, counters from the events as they happen."""

from __future__ import annotations

from collections.abc import Iterator

from prometheus_client import CollectorRegistry, Counter, Histogram
from prometheus_client.metrics_core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from orchestrator.core.manager import Orchestrator
from orchestrator.rest import Event
from shared.telemetry import SECONDS

LOST = ("degraded", "planner_lost")
"""What characters and episodes say when no planner answers."""


class _Now(Collector):
    """What can be read off the orchestrator at any time."""

    def __init__(self, core: Orchestrator):
        self._core = core

    def collect(self) -> Iterator[Metric]:
        core = self._core
        running = [e for e in core.episodes.values() if e.outcome is None]
        sessions = list(core.characters.values())
        yield GaugeMetricFamily("motionloop_characters", "Commanded characters", len(sessions))
        yield GaugeMetricFamily("motionloop_episodes_running", "Episodes under way", len(running))
        yield GaugeMetricFamily(
            "motionloop_degraded", "Characters without a planner", sum(s.status == "degraded" for s in sessions)
        )
        yield GaugeMetricFamily(
            "motionloop_recordings_unwritten_bytes", "Recorded and not yet written", core.backlog.held_bytes
        )
        yield CounterMetricFamily("motionloop_store_failed_writes", "Refused writes", core.store.failed_writes)


class OrchestratorMetrics:
    """The numbers of one orchestrator; counts its events from now on."""

    def __init__(self, core: Orchestrator):
        self.registry = CollectorRegistry()
        of: CollectorRegistry = self.registry
        self.registry.register(_Now(core))
        self._plans = Counter(
            "motionloop_plans", "Plans received, and whether they were used", ("accepted",), registry=of
        )
        self._plan_s = Histogram(
            "motionloop_plan_seconds",
            "From the request for a plan to the tracker's reply",
            buckets=SECONDS,
            registry=of,
        )
        self._commands = Counter("motionloop_commands", "Commands taken", registry=of)
        self._falls = Counter("motionloop_falls", "Characters that fell, and tasks with a fall", registry=of)
        self._episodes = Counter("motionloop_episodes", "Episodes that ended", ("status",), registry=of)
        self._lost = Counter("motionloop_planner_losses", "Times that a character lost its planner", registry=of)
        for accepted in ("true", "false"):
            self._plans.labels(accepted)
        core.observers.append(self.count)

    def count(self, event: Event) -> None:
        """Take in an event of a character or an episode."""
        data = event.data
        if event.type == "plan":
            self._plans.labels("true" if data.get("accepted") else "false").inc()
            self._plan_s.observe(float(data.get("total_ms", 0.0)) / 1e3)
        elif event.type == "command":
            self._commands.inc()
        elif event.type == "fallen" or (event.type == "task_end" and data.get("fell")):
            self._falls.inc()
        elif event.type == "end":
            self._episodes.labels(str(data.get("status"))).inc()
        elif event.type in LOST:
            self._lost.inc()
