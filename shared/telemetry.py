"""A service's numbers for Prometheus, on an HTTP port of loopback (orchestrator: /metrics of its own server)."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from threading import Thread
from wsgiref.simple_server import WSGIServer

from prometheus_client import CollectorRegistry, start_http_server

from shared.errors import InvalidInputError

SECONDS = (0.001, 0.002, 0.005, 0.01, 0.02, 0.033, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
"""Bounds of histograms of times; 0.033 s is one control tick."""
KEPT = 256


class MetricsEndpoint:
    """Serves a registry at http://127.0.0.1:PORT/metrics from `start` to `close`.

    Loopback only: the numbers go without a password. Prometheus on another machine asks through a tunnel or an agent.

    Args:
        registry: what to serve.
    """

    def __init__(self, registry: CollectorRegistry):
        self._registry = registry
        self._running: tuple[WSGIServer, Thread] | None = None

    def start(self, port: int | None) -> None:
        """Serve on `port`; 0 takes a free one, None serves nothing. Raises InvalidInputError for one that is taken."""
        if port is None:
            return
        try:
            self._running = start_http_server(port, "127.0.0.1", self._registry)
        except OSError as error:
            raise InvalidInputError(
                f"port {port} cannot be used: {error.strerror}", field="metrics_port", allowed="a free port, or 0"
            ) from error

    @property
    def url(self) -> str | None:
        """Where to ask, while it serves."""
        return f"http://127.0.0.1:{self._running[0].server_port}/metrics" if self._running else None

    def close(self) -> None:
        """Stop serving. Safe to call twice."""
        if self._running is not None:
            (server, thread), self._running = self._running, None
            server.shutdown()
            server.server_close()
            thread.join()


class Recent:
    """The last values of something, for a look by eye; Prometheus keeps the whole."""

    def __init__(self, kept: int = KEPT):
        self._values: deque[float] = deque(maxlen=kept)

    def add(self, values: Iterable[float]) -> None:
        """Take values in; the oldest go."""
        self._values.extend(values)

    def quantile(self, share: float) -> float:
        """The value that `share` (0..1) of them do not exceed; 0 without any."""
        ordered = sorted(self._values)
        return ordered[min(int(share * len(ordered)), len(ordered) - 1)] if ordered else 0.0
