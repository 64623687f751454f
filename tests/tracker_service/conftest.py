"""A running service and a connected client, over real sockets."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from shared.protocol.transport import ServiceClient
from tracker_service.service.service import TrackerService
from tracker_service.service.settings import TrackerServiceSettings


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TrackerService]:
    """A service on a free loopback port with small recording chunks, so that they reach the disk."""
    spool: Path = tmp_path_factory.mktemp("spool")
    settings = TrackerServiceSettings(
        endpoint="tcp://127.0.0.1:0", spool_dir=spool, chunk_samples=40, memory_chunks=1, max_characters=24
    )
    with TrackerService(settings) as running:
        yield running


@pytest.fixture
def client(service: TrackerService) -> Iterator[ServiceClient]:
    """A client of the service."""
    with ServiceClient(service.endpoint, "tracker") as connected:
        yield connected
