"""Serving the app with uvicorn: `python -m orchestrator`."""

from __future__ import annotations

import asyncio
import signal
import socket
import sys
from collections.abc import Callable
from types import FrameType

import uvicorn

from orchestrator.api.app import create_app, open_orchestrator
from orchestrator.api.listener import bind
from orchestrator.api.settings import OrchestratorSettings
from orchestrator.store.lock import FolderLock
from shared.garbage import spare_what_stays
from shared.spans import recorder_of, recording
from shared.tracing import configure_logging

GRACE_S = 3
"""For requests under way at the end; `docker compose` kills after 5 s."""


class _Server(uvicorn.Server):
    """Says where it listens once it does (the port may have been chosen by the system).

    Args:
        end_streams: called at the end, before it waits for requests: streams last as long as what they show.
    """

    def __init__(self, config: uvicorn.Config, end_streams: Callable[[], None]):
        super().__init__(config)
        self._end_streams = end_streams

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        if self.started and sockets:
            spare_what_stays()
            host, port = sockets[0].getsockname()[:2]
            sys.stdout.write(f"ready http://{host}:{port}\n")
            sys.stdout.flush()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        self._end_streams()
        await super().shutdown(sockets)


class _Ended(SystemExit):
    """A signal asked to end."""


def _end(number: int, frame: FrameType | None) -> None:
    raise _Ended(0)


def serve(settings: OrchestratorSettings) -> None:
    """Serve until SIGTERM or SIGINT; prints one ready line with the address.

    Raises:
        ConflictError: the port or the data folder is taken.
        UnavailableError: a service does not answer.
    """
    # uvicorn raises the signal once more after its shutdown: a clean end is exit code 0 and not death by SIGTERM.
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, _end)
    configure_logging("orchestrator", settings.log_level, settings.log_format)
    listener = bind(settings.host, settings.port)
    try:
        with recording(recorder_of("orchestrator")), FolderLock(settings.data_dir):
            asyncio.run(_serve(settings, listener))
    except _Ended:
        return
    finally:
        listener.close()


async def _serve(settings: OrchestratorSettings, listener: socket.socket) -> None:
    core = await open_orchestrator(settings)
    app = create_app(settings, core)
    config = uvicorn.Config(
        app, host=settings.host, port=settings.port, log_level="warning", log_config=None, lifespan="on",
        timeout_graceful_shutdown=GRACE_S, ws_ping_interval=20.0, ws_max_queue=32,
    )  # fmt: skip
    await _Server(config, core.end_streams).serve(sockets=[listener])
