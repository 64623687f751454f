"""How planner and tracker are, asked at most once a second however many viewers want to know."""

from __future__ import annotations

import asyncio
import time

from orchestrator.core.manager import Orchestrator
from orchestrator.core.services import Slot
from orchestrator.rest import ServiceHealth, ServicesHealth
from shared.errors import MotionLoopError
from shared.protocol.control import Health, HealthReport

ASK_TIMEOUT_S = 2.0
FRESH_S = 1.0


async def health_of(slot: Slot) -> ServiceHealth:
    """Ask one service how it is; never raises."""
    began = time.perf_counter()
    try:
        report = await slot.client.ask(Health(), HealthReport, timeout_s=ASK_TIMEOUT_S)
    except MotionLoopError as error:
        return ServiceHealth(status="away", plugin=slot.plugin_name, endpoint=slot.endpoint, message=error.message)
    return ServiceHealth(
        status=report.status,
        plugin=slot.plugin_name,
        endpoint=slot.endpoint,
        latency_ms=round((time.perf_counter() - began) * 1e3, 2),
        uptime_s=round(report.uptime_s, 1),
        detail=report.detail,
    )


class HealthWatch:
    """The last answer of both services, renewed when it is older than a second."""

    def __init__(self, core: Orchestrator):
        self._core = core
        self._lock = asyncio.Lock()
        self._asked_s = -FRESH_S
        self._slots: tuple[Slot, Slot] | None = None
        self._found: ServicesHealth | None = None

    async def look(self) -> ServicesHealth:
        """The present health; a swapped service is asked at once."""
        async with self._lock:
            services = self._core.services
            slots = (services.planner, services.tracker)
            if self._found is None or slots != self._slots or time.monotonic() - self._asked_s >= FRESH_S:
                planner, tracker = await asyncio.gather(health_of(slots[0]), health_of(slots[1]))
                self._found = ServicesHealth(planner=planner, tracker=tracker)
                self._slots, self._asked_s = slots, time.monotonic()
            return self._found
