"""A peer that was silent and is heard again gets what it has missed at once, not when its time to be repeated comes."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import pytest

from shared.errors import DeadlineError
from shared.protocol import client as protocol_client
from shared.protocol.control import Health, HealthReport
from shared.protocol.messages import Observe, Step, TrackReply
from shared.protocol.transport import AsyncServiceClient
from tests.protocol.chaos_proxy import ChaosProxy
from tests.protocol.test_transport import TRACK, Counting

NEVER_S = 3600.0
GIVE_UP_S = 300.0


@pytest.fixture(autouse=True)
def never_repeated(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing but questions for health is repeated by the clock: what comes again comes because the peer was heard."""
    monkeypatch.setattr(protocol_client, "RESEND_S", NEVER_S)


@pytest.fixture
def service() -> Counting:
    return Counting()


@pytest.fixture
def line(service: Counting) -> ChaosProxy:
    """A line to the service, which `share = 1` cuts."""
    with service.server() as server, ChaosProxy(server.endpoint, seed=1, share=0.0) as proxy:
        proxy.faults = ("drop",)
        yield proxy


async def until(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(GIVE_UP_S):
        while not condition():
            await asyncio.sleep(0.01)


def test_what_was_lost_is_sent_again_when_the_peer_is_heard(line: ChaosProxy, service: Counting) -> None:
    async def run() -> None:
        async with AsyncServiceClient(line.endpoint, "tracker") as client:
            await client.connect(GIVE_UP_S)
            line.share = 1.0
            lost = [
                asyncio.create_task(client.ask(Step(ticks=1), TrackReply, name, timeout_s=NEVER_S)) for name in "ab"
            ]
            await until(lambda: line.done["drop"] >= len(lost))
            health = asyncio.create_task(client.ask(Health(), HealthReport, timeout_s=NEVER_S))
            await until(lambda: line.done["drop"] >= len(lost) + 2)
            assert service.executed == []
            line.share = 0.0
            async with asyncio.timeout(GIVE_UP_S):
                await asyncio.gather(health, *lost)

    asyncio.run(run())
    assert sorted(service.executed) == [("a", 1), ("b", 1)], "each once"


def test_what_went_to_an_earlier_life_is_asked_of_the_new_one(
    service: Counting, free_endpoint: Callable[[], str]
) -> None:
    endpoint = free_endpoint()
    first = service.server(endpoint).start()

    async def run() -> None:
        async with AsyncServiceClient(endpoint, "tracker") as client:
            lost = asyncio.create_task(client.ask(TRACK, TrackReply, "a", timeout_s=NEVER_S))
            await until(lambda: len(service.futures) == 1)
            await asyncio.to_thread(first.stop)
            with service.server(endpoint):
                async with asyncio.timeout(GIVE_UP_S):
                    await client.ask(Step(ticks=1), TrackReply, "b", timeout_s=NEVER_S)
                    await until(lambda: len(service.futures) == 2)
                    service.futures[1].set_result(TrackReply(accepted=True, tick=7))
                    assert (await lost).tick == 7

    asyncio.run(run())


def test_silence_until_a_deadline_is_a_doubt_until_something_is_heard(line: ChaosProxy) -> None:
    async def run() -> None:
        async with AsyncServiceClient(line.endpoint, "tracker") as client:
            await client.connect(GIVE_UP_S)
            assert not client.in_doubt
            line.share = 1.0
            with pytest.raises(DeadlineError):
                await client.request(Observe(), "a", timeout_s=0.05)
            assert client.in_doubt
            line.share = 0.0
            await client.ask(Health(), HealthReport, timeout_s=GIVE_UP_S)
            assert not client.in_doubt

    asyncio.run(run())
