"""A character goes over to a tracker at another endpoint while it lives, and stays where the new one is unfit."""

from __future__ import annotations

from collections.abc import Iterator

import httpx
import pytest

from orchestrator.core.supervise import ServiceProcess, Stack
from shared.protocol.control import Health, HealthReport
from shared.protocol.transport import ServiceClient
from tests.orchestrator.support import running_service


@pytest.fixture
def other() -> Iterator[ServiceProcess]:
    """A second tracker service."""
    with running_service("tracker_service") as process:
        yield process


def hosted(address: str) -> int:
    """How many characters a tracker says it has."""
    with ServiceClient(address, "tracker") as peer:
        detail = peer.ask(Health(), HealthReport).detail
    return int(detail["characters"])


@pytest.mark.parametrize("tracker", ["kinematic", "pd"])
def test_a_character_moves_with_its_state_and_comes_back(
    stack: Stack, http: httpx.Client, other: ServiceProcess, tracker: str
) -> None:
    """Bit for bit as its twin that stays: the whole of the physics goes along."""
    spec = {"pacing": "lockstep", "tracker": tracker, "seed": 5}
    stayed = f"/v1/characters/{http.post('/v1/characters', json=spec).json()['id']}"
    wanted = [http.post(f"{stayed}/steps", json={"ticks": ticks}).json() for ticks in (45, 60, 60)]
    http.delete(stayed)
    path = f"/v1/characters/{http.post('/v1/characters', json=spec).json()['id']}"
    home = hosted(stack.tracker.address)
    assert http.post(f"{path}/steps", json={"ticks": 45}).json() == wanted[0]
    try:
        swapped = http.put("/v1/services/tracker", json={"endpoint": other.address, "plugin": tracker})
        assert swapped.status_code == 200, swapped.text
        assert http.post(f"{path}/steps", json={"ticks": 60}).json() == wanted[1]  # past a plan's boundary
        assert (hosted(other.address), hosted(stack.tracker.address)) == (1, home - 1)
    finally:
        back = http.put("/v1/services/tracker", json={"endpoint": stack.tracker.address, "plugin": tracker})
        assert back.status_code == 200, back.text
    assert http.post(f"{path}/steps", json={"ticks": 60}).json() == wanted[2]
    assert (hosted(other.address), hosted(stack.tracker.address)) == (0, home)
    http.delete(path)
    http.put("/v1/services/tracker", json={"plugin": "kinematic"}).raise_for_status()


def test_an_unfit_tracker_leaves_everything_as_it_is(stack: Stack, http: httpx.Client) -> None:
    path = f"/v1/characters/{http.post('/v1/characters', json={'pacing': 'lockstep'}).json()['id']}"
    used = http.get("/v1/services").json()["tracker"]
    for body in ({"endpoint": stack.planner.address}, {"endpoint": "tcp://127.0.0.1:9"}, {"plugin": "none such"}):
        refused = http.put("/v1/services/tracker", json=body)
        assert refused.status_code in (409, 422, 503), refused.text
        assert http.get("/v1/services").json()["tracker"] == used
    assert http.post(f"{path}/steps", json={"ticks": 30}).status_code == 200
    http.delete(path)
