"""The planner service over real sockets: batching, deadlines, bad plans, conformance; and as a process."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from planner_service.builtin.stand import StandPlanner
from planner_service.service.service import PlannerService
from planner_service.service.settings import PlannerSettings
from shared.errors import (
    DeadlineError,
    IncompatiblePeerError,
    InvalidInputError,
    MotionLoopError,
    SimulationError,
    UnavailableError,
)
from shared.plugins.conformance import (
    LocalProbe,
    check_planner,
    check_planner_endpoint,
    require,
    sample_request,
)
from shared.plugins.interfaces import Planner, PlannerSpec
from shared.plugins.registry import PLANNERS, PluginRegistry
from shared.protocol.control import Health, HealthReport
from shared.protocol.messages import JointTarget, Plan, PlanRequest
from shared.protocol.transport import AsyncServiceClient, ServiceClient
from tests.planner_service.motion import write_library

SPEC = StandPlanner().spec


class Gated:
    """A real planner (`stand`) that waits for a signal, notes its batches and can be told to misbehave."""

    def __init__(self, name: str = "gated") -> None:
        self.spec: PlannerSpec = SPEC.model_copy(update={"name": name})
        self.gate = threading.Event()
        self.entered = threading.Semaphore(0)
        self.batches: list[list[int]] = []

    def plan(self, requests: list[PlanRequest]) -> list[Plan]:
        self.batches.append([request.seed for request in requests])
        self.entered.release()
        assert self.gate.wait(20)
        return [self._one(request) for request in requests]

    def _one(self, request: PlanRequest) -> Plan:
        plan = StandPlanner().plan([request])[0]
        if request.text == "crash":
            raise ZeroDivisionError("oops")
        if request.text == "short":
            return plan.model_copy(update={"positions_w_m": plan.positions_w_m[:-1]})
        if request.text == "nan":
            return plan.model_copy(update={"positions_w_m": np.full_like(plan.positions_w_m, np.nan)})
        if request.text == "leap":
            return plan.model_copy(update={"positions_w_m": plan.positions_w_m + 5.0})
        return plan


def settings(**options: object) -> PlannerSettings:
    return PlannerSettings(endpoint="tcp://127.0.0.1:0", **options)  # type: ignore[arg-type]


def hosting(planner: Planner, **options: object) -> PlannerService:
    registry: PluginRegistry[Planner] = PluginRegistry(PLANNERS, {planner.spec.name: lambda: planner})
    return PlannerService(settings(**options), registry=registry)


@pytest.fixture
def gated() -> Iterator[Gated]:
    planner = Gated()
    yield planner
    planner.gate.set()


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PlannerService]:
    library = write_library(tmp_path_factory.mktemp("library"))
    with PlannerService(settings(plugins=("clip", "stand"), clip_library=library)) as service:
        yield service


@pytest.fixture(scope="module")
def client(service: PlannerService) -> Iterator[ServiceClient]:
    with ServiceClient(service.endpoint, "planner") as client:
        yield client


@pytest.mark.parametrize("name", ["stand", "clip", None])
def test_conformance_over_the_wire(service: PlannerService, name: str | None) -> None:
    require(check_planner_endpoint(service.endpoint, name))


def test_the_handshake_tells_all_planners(client: ServiceClient) -> None:
    welcome = client.connect()
    assert welcome.service == "planner"
    assert [plugin["name"] for plugin in welcome.plugins] == ["clip", "stand"]
    assert welcome.default_plugin == "clip"
    assert welcome.plugins[1]["skeleton"] == "human22"


def test_the_same_plan_here_and_over_the_wire(client: ServiceClient) -> None:
    request = sample_request(SPEC, planner="stand", at_w_m=(1.0, 2.0), heading_rad=0.7, horizon_frames=40)
    remote, local = client.ask(request, Plan), StandPlanner().plan([request])[0]
    np.testing.assert_array_equal(remote.positions_w_m, local.positions_w_m)
    np.testing.assert_array_equal(remote.rotations_6d, local.rotations_6d)
    assert remote.timings_ms["batch"] == 1


def test_health(client: ServiceClient) -> None:
    client.ask(sample_request(SPEC, planner="stand"), Plan)
    report = client.ask(Health(), HealthReport)
    assert report.status == "ok"
    assert float(report.detail["stand.plans"]) >= 1


@pytest.mark.parametrize(
    ("fields", "field"),
    [
        ({"planner": "nobody"}, "planner"),
        ({"horizon_frames": 200, "planner": "stand", "targets": []}, None),
        ({"targets": [JointTarget(joint="tail", position_w_m=(1, 0, 0), arrival_tick=60)]}, "targets.0.joint"),
        ({"targets": [JointTarget(joint="traj", position_w_m=(50, 0, 0), arrival_tick=60)]}, "targets.0.position_w_m"),
    ],
)
def test_bad_requests_name_the_field(client: ServiceClient, fields: dict[str, object], field: str | None) -> None:
    request = sample_request(SPEC, **fields)
    if field is None:
        assert len(client.ask(request, Plan).positions_w_m) == 200
        return
    with pytest.raises(InvalidInputError) as caught:
        client.request(request)
    assert caught.value.field == field
    assert caught.value.allowed


def test_requests_that_meet_are_planned_together(gated: Gated) -> None:
    async def ask(endpoint: str) -> list[Plan]:
        async with AsyncServiceClient(endpoint) as client:
            first = asyncio.create_task(client.ask(sample_request(SPEC, seed=0), Plan, "c0"))
            await asyncio.to_thread(gated.entered.acquire)
            others = [asyncio.create_task(client.ask(sample_request(SPEC, seed=n), Plan, f"c{n}")) for n in range(1, 6)]
            await asyncio.sleep(0)
            give_up = time.monotonic() + 10
            while (await client.ask(Health(), HealthReport)).detail["pending"] != 7 and time.monotonic() < give_up:
                await asyncio.sleep(0.01)
            gated.gate.set()
            return [await first, *await asyncio.gather(*others)]

    with hosting(gated, max_batch=4, max_wait_ms=50) as service:
        plans = asyncio.run(ask(service.endpoint))
    assert [plan.seed for plan in plans] == list(range(6))
    assert gated.batches[0] == [0]
    assert [len(batch) for batch in gated.batches] == [1, 4, 1]
    assert sorted(seed for batch in gated.batches for seed in batch) == list(range(6))


def test_an_expired_request_is_dropped(gated: Gated) -> None:
    async def ask(endpoint: str) -> None:
        async with AsyncServiceClient(endpoint) as client:
            first = asyncio.create_task(client.request(sample_request(SPEC, seed=1), "a"))
            await asyncio.to_thread(gated.entered.acquire)
            with pytest.raises(DeadlineError):
                await client.request(sample_request(SPEC, seed=2), "b", timeout_s=0.05)
            gated.gate.set()
            await first
            await client.request(sample_request(SPEC, seed=3), "c")

    with hosting(gated, max_batch=1) as service:
        asyncio.run(ask(service.endpoint))
    assert [seed for batch in gated.batches for seed in batch] == [1, 3]


@pytest.mark.parametrize(
    ("text", "code", "says"),
    [
        ("short", "simulation", "39 frames"),
        ("nan", "simulation", "non-finite"),
        ("leap", "simulation", "m/s"),
        ("crash", "internal", "ZeroDivisionError"),
    ],
)
def test_a_bad_plan_does_not_leave_the_service(gated: Gated, text: str, code: str, says: str) -> None:
    gated.gate.set()
    with hosting(gated) as service, ServiceClient(service.endpoint) as client:
        with pytest.raises(MotionLoopError, match=says) as caught:
            client.request(sample_request(SPEC, text=text))
        assert caught.value.code == code
        assert client.ask(sample_request(SPEC), Plan).planner == "stand"


def test_one_that_fails_does_not_spoil_its_batch(gated: Gated) -> None:
    async def ask(endpoint: str) -> None:
        async with AsyncServiceClient(endpoint) as client:
            await client.connect()
            texts = ("fine", "crash", "nan", "good")
            results = await asyncio.gather(
                *(client.request(sample_request(SPEC, text=text), text) for text in texts), return_exceptions=True
            )
        assert [type(result) for result in results] == [Plan, MotionLoopError, SimulationError, Plan]

    gated.gate.set()
    with hosting(gated, max_batch=4, max_wait_ms=200) as service:
        asyncio.run(ask(service.endpoint))
    assert len(gated.batches[0]) == 4


def test_what_a_planner_does_not_declare_is_reported_as_ignored() -> None:
    with hosting(StandPlanner()) as service, ServiceClient(service.endpoint) as client:
        request = sample_request(
            SPEC, text="walk", desired_velocity_w_mps=(1.0, 0.0), facing_rad=0.5, obstacle_pos_w_m=np.ones((1, 3)),
            keyframe_ticks=np.array([45]), keyframe_rotation_mask=np.ones((1, 22)), keyframe_mask=np.zeros((1, 22)),
            keyframe_positions_w_m=np.zeros((1, 22, 3)),
        )  # fmt: skip
        plan = client.ask(request, Plan, "c", timeout_s=10.0)
        assert plan.ignored_conditions == ["text", "velocity", "facing", "keyframe_rotations", "obstacles"]
        with pytest.raises(InvalidInputError) as caught:
            client.ask(request.model_copy(update={"fps": 30}), Plan, "c", timeout_s=10.0)
        assert (caught.value.field, caught.value.allowed) == ("fps", "20")


def test_conformance_finds_what_is_wrong() -> None:
    class Drunk:
        spec = SPEC.model_copy(update={"fps": 30.0, "conditions": ("mood",)})

        def __init__(self) -> None:
            self.calls = 0

        def plan(self, requests: list[PlanRequest]) -> list[Plan]:
            self.calls += 1
            plans = StandPlanner().plan([request.model_copy(update={"horizon_frames": 40}) for request in requests])
            return [p.model_copy(update={"positions_w_m": p.positions_w_m + 0.5 * self.calls}) for p in plans]

    results = check_planner(LocalProbe(Drunk()))
    failed = {result.name for result in results if not result.passed}
    assert failed >= {"spec", "seam", "horizon", "determinism"}
    assert "rotations" not in failed
    with pytest.raises(IncompatiblePeerError, match="seam"):
        require(results)


def test_a_planner_without_library_is_not_offered(tmp_path: Path) -> None:
    with PlannerService(settings(plugins=("clip", "stand"), clip_library=tmp_path)) as service:
        assert service.plugins == ("stand",)
        with ServiceClient(service.endpoint) as client:
            with pytest.raises(InvalidInputError, match="no recorded motion") as caught:
                client.request(sample_request(SPEC, planner="clip"))
            assert caught.value.allowed == "stand"
    with pytest.raises(UnavailableError, match="no recorded motion"):
        PlannerService(settings(plugins=("clip", "stand"), clip_library=tmp_path, default_plugin="clip")).start()


def test_stopping_refuses_what_waits(gated: Gated) -> None:
    service = hosting(gated, max_batch=1).start()
    errors: list[MotionLoopError] = []

    def ask(seed: int) -> None:
        with ServiceClient(service.endpoint) as client:
            try:
                client.request(sample_request(SPEC, seed=seed), f"c{seed}", timeout_s=1.0)
            except MotionLoopError as error:
                errors.append(error)

    threads = [threading.Thread(target=ask, args=(seed,)) for seed in (1, 2)]
    threads[0].start()
    assert gated.entered.acquire(timeout=10)
    threads[1].start()
    threading.Timer(0.2, gated.gate.set).start()
    service.stop()
    for thread in threads:
        thread.join(10)
    assert all(error.retryable for error in errors)


def start_process(*arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "planner_service", "--plugins", "stand", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        cwd=Path(__file__).resolve().parents[2],
    )


def test_the_process_says_when_it_is_ready_and_ends_on_sigterm(free_endpoint: Callable[[], str]) -> None:
    endpoint = free_endpoint()
    process = start_process("--endpoint", endpoint)
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == f"planner ready at {endpoint} with stand\n"
        with ServiceClient(endpoint, "planner", plugin="stand") as client:
            assert client.ask(sample_request(SPEC, horizon_frames=20), Plan).positions_w_m.shape == (20, 22, 3)
        process.send_signal(signal.SIGTERM)
        assert process.wait(20) == 0
    finally:
        process.kill()
        process.communicate()


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--endpoint", "tcp://0.0.0.0:5601"), "CURVE"),
        (("--threads", "0"), "threads"),
        (("--plugins", "nobody"), "dip, clip, stand, rise)"),
    ],
)
def test_the_process_refuses_what_it_cannot_do(arguments: tuple[str, ...], says: str) -> None:
    process = start_process(*arguments)
    _, errors = process.communicate(timeout=30)
    assert process.returncode == 2
    assert says in errors
