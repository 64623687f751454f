"""Numbers for Prometheus, read from the orchestrator when asked."""

from __future__ import annotations

from collections.abc import Iterator

from prometheus_client import CollectorRegistry
from prometheus_client.metrics_core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from orchestrator.core.manager import Orchestrator


class _Collector(Collector):
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
        loops = [s.loop for s in sessions] + [e.runner.loop for e in core.episodes.values()]
        yield CounterMetricFamily("motionloop_plans", "Plans received", sum(loop.plans_made for loop in loops))
        missed = sum(s.state.missed_ticks for s in sessions)
        yield CounterMetricFamily("motionloop_missed_ticks", "Ticks that ran late", missed)
        yield CounterMetricFamily("motionloop_store_failed_writes", "Refused writes", core.store.failed_writes)


def registry_of(core: Orchestrator) -> CollectorRegistry:
    """A registry that reads the orchestrator."""
    registry = CollectorRegistry()
    registry.register(_Collector(core))
    return registry
