"""The three services as processes, shared by the tests of this folder."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from orchestrator.client import Client
from orchestrator.core.supervise import Stack
from tests.orchestrator.support import light
from tests.planner_service.motion import write_library


@pytest.fixture(scope="session")
def stack(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """Planner, tracker and orchestrator with the plug-ins `stand` and `kinematic`; `clip` and `pd` are there too."""
    library = write_library(tmp_path_factory.mktemp("library"))
    with Stack(light(tmp_path_factory.mktemp("data"), library)) as running:
        yield running


@pytest.fixture
def client(stack: Stack) -> Iterator[Client]:
    """A client whose characters are ended after the test."""
    with Client(stack.url) as opened:
        yield opened
        for character in opened.characters:
            character.close()
