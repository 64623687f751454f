"""More than there is room for is turned away with a time to come back, while what runs keeps its clock."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace

import httpx
import psutil
import pytest

from orchestrator.core.supervise import Stack
from shared.protocol.messages import Observe, StateFrame
from shared.protocol.transport import ServiceClient
from tests.orchestrator.support import light

CALLERS = 6
TICKS = 90
GROWTH_BYTES = 64 * 2**20


@pytest.fixture(scope="module")
def narrow(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """A stack with little room."""
    more = ("--max-rate-per-s", "5", "--max-requests", "2", "--max-running", "2")
    with Stack(replace(light(tmp_path_factory.mktemp("data")), orchestrator_args=more)) as running:
        yield running


def flood(url: str, paths: list[tuple[str, str]], over: threading.Event, told: Counter[str]) -> None:
    """Ask as fast as answers come; every refusal says when to come back."""
    with httpx.Client(base_url=url, timeout=60.0) as http:
        while not over.is_set():
            for method, path in paths:
                answer = http.request(method, path, json={"tasks": [{"type": "halt"}]} if method == "POST" else None)
                told[str(answer.status_code)] += 1
                if answer.status_code in (429, 503):
                    told["without a time" if int(answer.headers.get("retry-after", 0)) < 1 else "with a time"] += 1


def test_a_flood_is_turned_away_and_a_character_keeps_its_clock(narrow: Stack) -> None:
    with httpx.Client(base_url=narrow.url, timeout=60.0) as http:
        character_id = str(http.post("/v1/characters", json={}).json()["id"])
    paths = [("GET", "/v1/characters"), ("GET", "/v1/scenes"), ("POST", "/v1/episodes")]
    over, told = threading.Event(), [Counter[str]() for _ in range(CALLERS)]
    callers = [threading.Thread(target=flood, args=(narrow.url, paths, over, each)) for each in told]
    assert narrow.orchestrator is not None
    server = psutil.Process(narrow.orchestrator.pid)
    with ServiceClient(narrow.tracker.address, "tracker") as tracker:

        def tick() -> int:
            return tracker.ask(Observe(), StateFrame, character_id, timeout_s=60.0).tick

        begin = tick()
        for caller in callers:
            caller.start()
        try:
            while tick() < begin + TICKS or sum(sum(each.values()) for each in told) < 20 * CALLERS:
                continue
            before = server.memory_info().rss
            middle = tick()
            while tick() < middle + TICKS:
                continue
            growth = server.memory_info().rss - before
        finally:
            over.set()
            for caller in callers:
                caller.join()
    total = sum(told, Counter[str]())
    assert set(total) <= {"200", "201", "429", "503", "with a time"}, total
    assert total["with a time"] > 0
    assert growth < GROWTH_BYTES
    with httpx.Client(base_url=narrow.url, timeout=60.0) as http:
        assert http.get("/healthz").status_code == 200
