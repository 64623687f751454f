"""The planner service: plug-ins behind a ROUTER socket, one batching thread each."""

from __future__ import annotations

import time
from concurrent.futures import Future
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import zmq

from planner_service.service.batching import Batcher
from planner_service.service.metrics import PlannerMetrics
from planner_service.service.plugins import planner_registry
from planner_service.service.settings import PlannerSettings
from shared.errors import InvalidInputError, UnavailableError
from shared.plugins.checks import fit_request
from shared.plugins.interfaces import Planner, TextReader
from shared.plugins.registry import PluginRegistry
from shared.protocol.base import Message
from shared.protocol.control import Envelope, Health, HealthReport, Hello, Welcome
from shared.protocol.messages import PlanRequest, ReadText, TextRead
from shared.protocol.transport import ServiceServer

PREFERRED = ("dip", "clip", "stand")


def package_version() -> str:
    """Of the installed distribution; "0" in a checkout that was never installed."""
    try:
        return version("motionloop")
    except PackageNotFoundError:
        return "0"


class PlannerService:
    """Hosts planners. All that the settings allow are loaded by `start`, so that the handshake tells their weights.

    Args:
        settings: see PlannerSettings.
        context: ZeroMQ context to share, for inproc endpoints.
        registry: where planners come from; None for the built-ins and what is installed.
    """

    def __init__(
        self,
        settings: PlannerSettings,
        *,
        context: zmq.Context[Any] | None = None,
        registry: PluginRegistry[Planner] | None = None,
    ):
        self._settings = settings
        self._registry = registry if registry is not None else planner_registry(settings)
        self._planners: dict[str, Planner] = {}
        self._batchers: dict[str, Batcher] = {}
        self._default = ""
        self._started = time.monotonic()
        self._server = ServiceServer(
            settings.endpoint,
            {PlanRequest: self._plan, ReadText: self._read, Health: self._health},
            self._welcome,
            workers=settings.workers,
            max_pending=settings.max_pending,
            context=context,
            curve=settings.curve_keys(),
        )
        self.metrics = PlannerMetrics(lambda: self._server.pending)

    @property
    def endpoint(self) -> str:
        """Where the service listens, with the port it got."""
        return self._server.endpoint

    @property
    def plugins(self) -> tuple[str, ...]:
        """Names of the planners that are loaded."""
        return tuple(self._planners)

    def start(self) -> PlannerService:
        """Load the planners and serve. Raises UnavailableError if none, or not the default one, can be loaded."""
        self._planners = self._registry.load_all()
        self._default = self._choose_default()
        self._batchers = {
            name: Batcher(planner, self._settings.max_batch, self._settings.max_wait_ms / 1e3, self.metrics)
            for name, planner in self._planners.items()
        }
        self._settings.start_metrics(self.metrics.endpoint)
        self._server.start()
        return self

    def stop(self) -> None:
        """Refuse what waits, finish what is being planned, close. Safe to call twice."""
        for batcher in self._batchers.values():
            batcher.close()
        self._batchers = {}
        self._server.stop()
        self.metrics.endpoint.close()

    def __enter__(self) -> PlannerService:
        return self.start()

    def __exit__(self, *_: object) -> None:
        self.stop()

    def _choose_default(self) -> str:
        names = tuple(self._planners)
        wanted = self._settings.default_plugin
        if wanted is not None and wanted not in names:
            reason = self._registry.withdrawn().get(wanted, "there is no such planner")
            raise UnavailableError(
                f"default planner {wanted!r} is not available: {reason}",
                field="default_plugin",
                allowed=", ".join(names),
            )
        if not names:
            raise UnavailableError(f"no planner can be loaded: {self._registry.withdrawn()}", field="plugins")
        return wanted or next((name for name in PREFERRED if name in names), names[0])

    def _welcome(self, hello: Hello) -> Welcome:
        return Welcome(
            service="planner",
            version=package_version(),
            instance_id=self._server.instance_id,
            default_plugin=self._default,
            plugins=[planner.spec.model_dump(mode="json") for planner in self._planners.values()],
        )

    def _plan(self, envelope: Envelope, request: PlanRequest) -> Future[Message]:
        planner = self._named(request.planner)
        return self._batchers[planner.spec.name].submit(fit_request(request, planner.spec), envelope.deadline_unix_s)

    def _read(self, envelope: Envelope, request: ReadText) -> TextRead:
        planner = self._named(request.planner)
        return planner.read_text(request.text) if isinstance(planner, TextReader) else TextRead()

    def _named(self, name: str | None) -> Planner:
        name = name or self._default
        if name not in self._batchers:
            reason = self._registry.withdrawn().get(name)
            raise InvalidInputError(
                f"no planner {name!r}" + (f": {reason}" if reason else ""),
                field="planner",
                allowed=", ".join(self._planners),
            )
        return self._planners[name]

    def _health(self, envelope: Envelope, message: Health) -> HealthReport:
        batchers = dict(self._batchers)
        detail: dict[str, float | int | str] = {"default": self._default, "pending": self._server.pending}
        detail |= self.metrics.detail()
        for name, batcher in batchers.items():
            detail[f"{name}.plans"] = batcher.plans_made
            detail[f"{name}.batches"] = batcher.batches_made
        for name, reason in self._registry.withdrawn().items():
            detail[f"{name}.withdrawn"] = reason
        return HealthReport(status="ok", uptime_s=time.monotonic() - self._started, detail=detail)
