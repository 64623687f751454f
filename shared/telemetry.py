"""A service's numbers for Prometheus, on an HTTP port of its own (orchestrator: /metrics of its own server)."""

from __future__ import annotations

import secrets
import socket
from collections import deque
from collections.abc import Callable, Iterable
from socketserver import ThreadingMixIn
from threading import Thread
from typing import Any
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer, make_server

from prometheus_client import CollectorRegistry, make_wsgi_app

from shared.errors import InvalidInputError

SECONDS = (0.001, 0.002, 0.005, 0.01, 0.02, 0.033, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
"""Bounds of histograms of times; 0.033 s is one control tick."""
KEPT = 256


QUIET_S = 10.0
"""A caller that says nothing for so long is hung up on."""


class _Server(ThreadingMixIn, WSGIServer):
    daemon_threads = True


class _Server6(_Server):
    address_family = socket.AF_INET6


class _Handler(WSGIRequestHandler):
    timeout = QUIET_S

    def log_message(self, format: str, *args: Any) -> None:  # the base class has the name
        """A scrape every few seconds is no news."""


class MetricsEndpoint:
    """Serves a registry at http://HOST:PORT/metrics from `start` to `close`.

    Args:
        registry: what to serve.
    """

    def __init__(self, registry: CollectorRegistry):
        self._registry = registry
        self._running: tuple[WSGIServer, Thread] | None = None

    def start(self, port: int | None, host: str = "127.0.0.1", token: str | None = None) -> None:
        """Serve on `port`; 0 takes a free one, None serves nothing. With a token only to those who bear it.

        Raises InvalidInputError for a port that is taken, or a host that is not this machine's.
        """
        if port is None:
            return
        app = _guarded(make_wsgi_app(self._registry), token)
        try:
            server = make_server(host, port, app, _Server6 if ":" in host else _Server, _Handler)
        except OSError as error:
            raise InvalidInputError(
                f"port {port} cannot be used: {error.strerror}", field="metrics_port", allowed="a free port, or 0"
            ) from error
        thread = Thread(target=server.serve_forever, name="metrics", daemon=True)
        thread.start()
        self._running = (server, thread)

    @property
    def url(self) -> str | None:
        """Where to ask, while it serves."""
        if self._running is None:
            return None
        host, port = self._running[0].server_address[:2]
        return f"http://{host!s}:{port}/metrics"

    def close(self) -> None:
        """Stop serving. Safe to call twice."""
        if self._running is not None:
            (server, thread), self._running = self._running, None
            server.shutdown()
            server.server_close()
            thread.join()


def _guarded(app: Callable[..., Any], token: str | None) -> Callable[..., Any]:
    if token is None:
        return app
    wanted = f"Bearer {token}".encode()

    def guard(environ: dict[str, Any], start_response: Callable[..., Any]) -> Any:
        given = str(environ.get("HTTP_AUTHORIZATION", "")).encode()
        if secrets.compare_digest(given, wanted):
            return app(environ, start_response)
        start_response("401 Unauthorized", [("WWW-Authenticate", "Bearer"), ("Content-Type", "text/plain")])
        return [b"a bearer token is needed\n"]

    return guard


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
