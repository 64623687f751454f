"""What the tracker service counts and times, from the frames it publishes."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram

from shared.protocol.messages import StateFrame
from shared.telemetry import SECONDS, MetricsEndpoint, Recent

METRES = (0.02, 0.04, 0.06, 0.08, 0.1, 0.15, 0.2, 0.3, 0.5, 1.0)


@dataclass(frozen=True)
class _Last:
    """What the last frame of a character said."""

    tick: int
    missed_ticks: int
    fallen: bool
    stalled: bool
    failed: bool


class TrackerMetrics:
    """Numbers of one tracker service. Methods may be called from any thread.

    Args:
        characters: tells how many are hosted.
        pending: tells how many requests are admitted and not yet answered.
    """

    def __init__(self, characters: Callable[[], float], pending: Callable[[], float]):
        of = CollectorRegistry()
        self.endpoint = MetricsEndpoint(of)
        self._ticks = Counter("motionloop_tracker_ticks", "Control ticks performed", registry=of)
        self._missed = Counter("motionloop_tracker_missed_ticks", "Ticks more than one tick late", registry=of)
        self._falls = Counter("motionloop_tracker_falls", "Characters that fell", registry=of)
        self._stalls = Counter("motionloop_tracker_stalls", "Plans that ran out before another came", registry=of)
        self._failures = Counter("motionloop_tracker_failures", "Ticks at which physics or policy failed", registry=of)
        self._error_m = Histogram(
            "motionloop_tracker_error_metres", "Mean distance of the joints from the plan, by frame", buckets=METRES,
            registry=of,
        )  # fmt: skip
        self._tick_s = Histogram(
            "motionloop_tracker_tick_seconds", "Computing one tick of one character", buckets=SECONDS, registry=of
        )
        hosted = Gauge("motionloop_tracker_characters", "Characters hosted", registry=of)
        hosted.set_function(characters)
        waiting = Gauge("motionloop_tracker_pending", "Requests admitted and not yet answered", registry=of)
        waiting.set_function(pending)
        self._recent_ms = Recent()
        self._lock = threading.Lock()
        self._last: dict[str, _Last] = {}
        self.falls = self.stalls = self.ticks = 0

    def ticked(self, seconds: float) -> None:
        """Take in how long a tick took to compute."""
        self._tick_s.observe(seconds)
        with self._lock:
            self._recent_ms.add([seconds * 1e3])

    def framed(self, frame: StateFrame) -> None:
        """Take in a published frame: what it says that the character's last one did not."""
        stalled = frame.tick > frame.plan_end_tick > 0
        now = _Last(frame.tick, frame.missed_ticks, frame.fallen, stalled, frame.failure is not None)
        with self._lock:
            before = self._last.get(frame.character_id, _Last(frame.tick, 0, False, stalled, False))
            self._last[frame.character_id] = now
            # A restored character begins at an earlier tick than its last frame: what is done again counts again.
            ticks = max(now.tick - before.tick, 0)
            fell, stall = now.fallen and not before.fallen, now.stalled and not before.stalled
            self.ticks, self.falls, self.stalls = self.ticks + ticks, self.falls + fell, self.stalls + stall
        self._ticks.inc(ticks)
        self._missed.inc(max(now.missed_ticks - before.missed_ticks, 0))
        self._falls.inc(fell)
        self._stalls.inc(stall)
        self._failures.inc(now.failed and not before.failed)
        if ticks:
            self._error_m.observe(frame.tracking_error_m)

    def closed(self, character_id: str) -> None:
        """Forget a character that was closed."""
        with self._lock:
            self._last.pop(character_id, None)

    def detail(self) -> dict[str, float | int | str]:
        """For the service's report of its health."""
        with self._lock:
            return {
                "ticks": self.ticks,
                "falls": self.falls,
                "stalls": self.stalls,
                "tick_ms": round(self._recent_ms.quantile(0.5), 2),
                "tick_ms_p95": round(self._recent_ms.quantile(0.95), 2),
            }
