"""What the tests of this folder share: a stack that starts quickly, and an episode played to its end."""

from __future__ import annotations

import contextlib
import io
import sys
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import numpy as np

from orchestrator.core.keeper import BackOff, Keeper
from orchestrator.core.manager import Orchestrator
from orchestrator.core.services import Services, connect
from orchestrator.core.supervise import Say, ServiceProcess, Stack, StackOptions
from orchestrator.store.database import SqliteStore
from planner_service.builtin.stand import StandPlanner
from planner_service.service.service import PlannerService
from planner_service.service.settings import PlannerSettings
from shared.plugins.interfaces import Planner
from shared.plugins.registry import PLANNERS, PluginRegistry
from shared.protocol.messages import Plan, PlanRequest

FREE = "tcp://127.0.0.1:0"
LIGHT = StackOptions(planner_plugin="stand", tracker_plugin="kinematic", planner_args=("--plugins", "stand"))
"""Without torch a planner is there in a second."""


class Noting:
    """`stand`, which remembers what it was asked.

    Args:
        spec: what its specification says otherwise.
    """

    def __init__(self, **spec: object) -> None:
        self.spec = StandPlanner().spec.model_copy(update=spec)
        self.asked: list[PlanRequest] = []

    def plan(self, requests: list[PlanRequest]) -> list[Plan]:
        """As `stand` does."""
        self.asked += requests
        return StandPlanner().plan(requests)


def light(data_dir: Path, library: Path | None = None) -> StackOptions:
    """Options for `stand` and `kinematic`; with a library `clip` is offered too."""
    options = replace(LIGHT, data_dir=str(data_dir))
    if library is None:
        return options
    return replace(options, planner_args=("--plugins", "stand,clip", "--clip-library", str(library)))


def play(http: httpx.Client, spec: dict[str, Any]) -> tuple[dict[str, Any], dict[str, bytes]]:
    """Run an episode to its end; what became of it, and every array of its recording as bytes."""
    reply = http.post("/v1/episodes", json=spec)
    assert reply.status_code == 201, reply.text
    path = f"/v1/episodes/{reply.json()['id']}"
    # The stream of events ends with the episode.
    assert '"type":"end"' in http.get(f"{path}/events").text.replace(" ", "")
    return http.get(path).json(), arrays_of(http, path.rpartition("/")[2])


def arrays_of(http: httpx.Client, episode_id: str) -> dict[str, bytes]:
    """Every array of an episode's recording as bytes."""
    content = http.get(f"/v1/episodes/{episode_id}/motion.npz").content
    with np.load(io.BytesIO(content), allow_pickle=False) as data:
        return {name: data[name].tobytes() for name in data.files}


@contextlib.contextmanager
def served(planner: Planner, data_dir: Path) -> Iterator[tuple[str, str]]:
    """Endpoints of a planner of one's own, in this process under the name `stand`, and of a tracker."""
    registry: PluginRegistry[Planner] = PluginRegistry(PLANNERS, {"stand": lambda: planner})
    stack = Stack(light(data_dir))
    stack.tracker.start()
    try:
        tracker = stack.tracker.wait_ready(60.0)
        with PlannerService(PlannerSettings(endpoint=FREE), registry=registry) as service:
            yield service.endpoint, tracker
    finally:
        stack.stop()


async def orchestrator_on(stack: Stack, data_dir: Path, unwritten_mb: float = 256.0) -> Orchestrator:
    """An orchestrator in this process, on the planner and the tracker of a stack; to be closed."""
    tracker = await connect(stack.tracker.address, "tracker", timeout_s=60.0)
    services = Services(await connect(stack.planner.address, "planner"), tracker, rescue_s=600.0)
    return Orchestrator(services, SqliteStore(data_dir), unwritten_mb=unwritten_mb)


def arrays_in(recording: Path) -> dict[str, bytes]:
    """Every array of a recording as bytes."""
    with np.load(recording, allow_pickle=False) as data:
        return {name: data[name].tobytes() for name in data.files}


@contextlib.contextmanager
def running(name: str, *command: str) -> Iterator[ServiceProcess]:
    """A service process that is ready, and stopped in the end."""
    process = ServiceProcess(name, list(command))
    process.start()
    try:
        process.wait_ready()
        yield process
    finally:
        process.stop()


def running_service(module: str, *options: str) -> contextlib.AbstractContextManager[ServiceProcess]:
    """`python -m MODULE` on a free port."""
    return running(module, sys.executable, "-m", module, "--endpoint", FREE, *options)


@contextlib.contextmanager
def kept_up(stack: Stack, say: Say = lambda line: None) -> Iterator[Keeper]:
    """Within it, what ends of a stack is started again soon. What was started in it ends with it: a process is told of
    the death of the thread that started it."""
    keeper, over = Keeper(stack, say, BackOff(first_s=0.1, longest_s=0.4)), threading.Event()

    def look() -> None:
        while not over.wait(0.05):
            keeper.look()

    looking = threading.Thread(target=look, name="keeper")
    looking.start()
    try:
        yield keeper
    finally:
        over.set()
        looking.join()
