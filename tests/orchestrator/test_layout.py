"""The same episode everywhere: one process or three, any pair of plug-ins, named in the episode or swapped in."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from fastapi.testclient import TestClient

from orchestrator.api.app import create_app
from orchestrator.api.settings import OrchestratorSettings
from orchestrator.core.supervise import Stack, StackOptions
from planner_service.dip.weights import SHIPPED
from planner_service.service.service import PlannerService
from planner_service.service.settings import PlannerSettings
from tests.orchestrator.support import play
from tracker_service.service.service import TrackerService
from tracker_service.service.settings import TrackerServiceSettings

TASKS = [
    {"type": "reach", "relative_m": [1.0, 0.5], "time_limit_s": 1.0},
    {"type": "text", "text": "a person is waving.", "duration_s": 1.0},
]


@pytest.fixture(scope="module")
def three_processes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[httpx.Client]:
    """An HTTP client of three processes that offer every plug-in; plans are made one at a time."""
    options = StackOptions(data_dir=str(tmp_path_factory.mktemp("data")), planner_args=("--max-batch", "1"))
    with Stack(options) as stack, httpx.Client(base_url=stack.url, timeout=60.0) as client:
        yield client


@pytest.fixture(scope="module")
def one_process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[httpx.Client]:
    """An HTTP client of the same three services as threads of this process; they still speak over sockets."""
    anywhere = "tcp://127.0.0.1:0"
    spool: Path = tmp_path_factory.mktemp("spool")
    with (
        PlannerService(PlannerSettings(endpoint=anywhere, max_batch=1)) as planner,
        TrackerService(TrackerServiceSettings(endpoint=anywhere, spool_dir=spool)) as tracker,
    ):
        settings = OrchestratorSettings(planner=planner.endpoint, tracker=tracker.endpoint, data_dir=spool / "data")
        with TestClient(create_app(settings)) as client:
            yield client


@pytest.mark.parametrize(("planner", "tracker"), [("stand", "pd"), ("dip", "learned")])
def test_lockstep_gives_the_same_log_in_one_process_and_in_three(
    one_process: httpx.Client, three_processes: httpx.Client, planner: str, tracker: str
) -> None:
    """Bit for bit: positions, velocities, contacts, objects, references, plans."""
    if planner == "dip" and not SHIPPED.is_file():
        pytest.skip(f"no weights at {SHIPPED}")
    spec = {"tasks": TASKS, "seed": 7, "planner": planner, "tracker": tracker, "time_limit_s": 8, "scene": "balls"}
    here, log_here = play(one_process, spec)
    there, log_there = play(three_processes, spec)
    assert log_here.keys() == log_there.keys()
    assert [name for name in log_here if log_here[name] != log_there[name]] == []
    assert here["tick"] == there["tick"] >= 60
    assert here["results"] == there["results"] != []
    if planner == "dip":
        _, another = play(one_process, {**spec, "seed": 8})
        assert another["body_pos_w_m"] != log_here["body_pos_w_m"]


@pytest.mark.parametrize("tracker", ["pd", "kinematic"])
@pytest.mark.parametrize("planner", ["clip", "stand"])
def test_the_same_episode_runs_with_every_pair_by_setting_and_by_swap(
    stack: Stack, http: httpx.Client, planner: str, tracker: str
) -> None:
    spec: dict[str, Any] = {"tasks": TASKS, "seed": 4, "time_limit_s": 8}
    by_setting, log = play(http, {**spec, "planner": planner, "tracker": tracker})
    assert by_setting["status"] == "finished"
    assert [result["type"] for result in by_setting["results"]] == ["reach", "text"]
    before = http.get("/v1/services").json()
    try:
        for kind, plugin in (("planner", planner), ("tracker", tracker)):
            swapped = http.put(f"/v1/services/{kind}", json={"plugin": plugin})
            assert (swapped.status_code, swapped.json()["plugin"]) == (200, plugin)
        by_swap, same_log = play(http, spec)
    finally:
        for kind in ("planner", "tracker"):
            http.put(f"/v1/services/{kind}", json={"plugin": before[kind]["plugin"]})
    assert http.get("/v1/services").json() == before
    assert by_swap["results"] == by_setting["results"]
    assert [name for name in log if log[name] != same_log[name]] == []
