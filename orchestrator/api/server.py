"""Serving the app with uvicorn: `python -m orchestrator`."""

from __future__ import annotations

import signal
import socket
import sys
from types import FrameType

import uvicorn

from orchestrator.api.app import create_app
from orchestrator.api.settings import OrchestratorSettings


class _Server(uvicorn.Server):
    """Says where it listens once it does (the port may have been chosen by the system)."""

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        if self.started and sockets:
            host, port = sockets[0].getsockname()[:2]
            sys.stdout.write(f"ready http://{host}:{port}\n")
            sys.stdout.flush()


def _end(number: int, frame: FrameType | None) -> None:
    raise SystemExit(0)


def serve(settings: OrchestratorSettings) -> None:
    """Serve until SIGTERM or SIGINT; prints one ready line with the address."""
    config = uvicorn.Config(
        create_app(settings), host=settings.host, port=settings.port, log_level="warning", lifespan="on",
        timeout_graceful_shutdown=5, ws_ping_interval=20.0, ws_max_queue=32,
    )  # fmt: skip
    # uvicorn raises the signal once more after its shutdown: a clean end is exit code 0 and not death by SIGTERM.
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, _end)
    listener = config.bind_socket()
    try:
        _Server(config).run(sockets=[listener])
    finally:
        listener.close()
