"""Real sockets: replies, errors, idempotence, deadlines, restarts, wrong peers."""

from __future__ import annotations

import asyncio
import json
import threading
import time
import zlib
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from pathlib import Path

import numpy as np
import pytest
import zmq

from shared.errors import (
    ConflictError,
    DeadlineError,
    IncompatiblePeerError,
    InvalidInputError,
    MotionLoopError,
    OverloadedError,
    UnavailableError,
)
from shared.protocol.base import Message
from shared.protocol.codec import decode, encode
from shared.protocol.control import Envelope, ErrorReply, Health, HealthReport, Hello, Ok, Welcome
from shared.protocol.messages import Impulse, Observe, Step, Track, TrackReply
from shared.protocol.transport import AsyncServiceClient, ServiceClient, ServiceServer


class Counting:
    """A small service: Step counts what was executed; Impulse waits for `gate`; Track replies through a Future."""

    def __init__(self) -> None:
        self.executed: list[tuple[str | None, int]] = []
        self.running: set[str | None] = set()
        self.overlapped = False
        self.gate = threading.Event()
        self.entered = threading.Semaphore(0)
        self.futures: list[Future[Message]] = []

    def step(self, envelope: Envelope, message: Step) -> Message:
        self.overlapped |= envelope.character_id in self.running
        self.running.add(envelope.character_id)
        if message.ticks == 2999:
            raise ConflictError("paused", field="pacing", allowed="lockstep")
        if message.ticks == 2998:
            raise ZeroDivisionError("oops")
        self.executed.append((envelope.character_id, message.ticks))
        self.running.discard(envelope.character_id)
        return TrackReply(accepted=True, tick=len(self.executed))

    def impulse(self, envelope: Envelope, message: Impulse) -> Message:
        self.entered.release()
        assert self.gate.wait(20)
        self.executed.append((envelope.character_id, 0))
        return Ok()

    def track(self, envelope: Envelope, message: Track) -> Future[Message]:
        self.futures.append(Future())
        self.entered.release()
        return self.futures[-1]

    def server(self, endpoint: str = "tcp://127.0.0.1:0", **options: object) -> ServiceServer:
        handlers = {Step: self.step, Impulse: self.impulse, Track: self.track, Health: lambda e, m: report()}
        return ServiceServer(endpoint, handlers, welcome, **options)  # type: ignore[arg-type]


def report() -> HealthReport:
    return HealthReport(status="ok", uptime_s=1.0)


def welcome(hello: Hello) -> Welcome:
    return Welcome(
        service="tracker", version="1", instance_id="x", default_plugin="pd",
        plugins=[{"name": "pd", "skeleton": "human22"}, {"name": "robot", "skeleton": "g1"}],
    )  # fmt: skip


PUSH = Impulse(body="pelvis", impulse_w_ns=(1.0, 0.0, 0.0))
TRACK = Track(start_tick=0, positions_w_m=np.zeros((2, 22, 3)), rotations_6d=np.zeros((2, 22, 6)))


@pytest.fixture
def service() -> Counting:
    return Counting()


@pytest.fixture
def server(service: Counting) -> Iterator[ServiceServer]:
    with service.server(workers=4, max_pending=8) as server:
        yield server
        service.gate.set()


@pytest.fixture
def client(server: ServiceServer) -> Iterator[ServiceClient]:
    with ServiceClient(server.endpoint, "tracker") as client:
        yield client


def test_a_request_gets_its_reply(client: ServiceClient, service: Counting) -> None:
    assert client.ask(Step(ticks=3), TrackReply, "walker").tick == 1
    assert service.executed == [("walker", 3)]
    assert client.request(Health()) == report()
    assert client.welcome is not None
    assert client.welcome.service == "tracker"


@pytest.mark.parametrize("scheme", ["tcp", "ipc", "inproc"])
def test_every_scheme(scheme: str, service: Counting, tmp_path: Path) -> None:
    endpoint = {"tcp": "tcp://127.0.0.1:0", "ipc": f"ipc://{tmp_path}/s", "inproc": "inproc://service"}[scheme]
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    with (
        service.server(endpoint, context=context) as server,
        ServiceClient(server.endpoint, "tracker", context=context) as client,
    ):
        assert client.ask(Step(ticks=1), TrackReply).tick == 1
    context.term()


def test_errors_arrive_as_they_were_raised(client: ServiceClient) -> None:
    with pytest.raises(ConflictError, match="paused") as caught:
        client.request(Step(ticks=2999))
    assert (caught.value.field, caught.value.allowed, caught.value.retryable) == ("pacing", "lockstep", False)
    with pytest.raises(MotionLoopError, match="ZeroDivisionError: oops") as unexpected:
        client.request(Step(ticks=2998))
    assert unexpected.value.code == "internal"
    with pytest.raises(InvalidInputError) as unknown:
        client.request(Observe())
    assert unknown.value.allowed == "Health, Impulse, Step, Track"


def test_a_repeated_id_is_answered_and_not_executed_again(client: ServiceClient, service: Counting) -> None:
    first = client.request(Step(ticks=1), "a", message_id="repeated-id")
    assert client.request(Step(ticks=1), "a", message_id="repeated-id") == first
    assert len(service.executed) == 1
    with pytest.raises(InvalidInputError) as caught:
        client.request(Step(ticks=1), "b", message_id="repeated-id")
    assert caught.value.field == "message_id"


def test_a_repeated_id_from_a_second_client_waits_for_the_first_reply(
    server: ServiceServer, client: ServiceClient, service: Counting
) -> None:
    replies: list[Message] = []
    asking = [
        threading.Thread(target=lambda: replies.append(client.request(PUSH, "a", message_id="in-progress"))),
    ]
    with ServiceClient(server.endpoint) as other:
        asking.append(
            threading.Thread(target=lambda: replies.append(other.request(PUSH, "a", message_id="in-progress")))
        )
        asking[0].start()
        assert service.entered.acquire(timeout=10)
        asking[1].start()
        other_is_known = time.monotonic() + 10
        while other.welcome is None and time.monotonic() < other_is_known:
            time.sleep(0.01)
        service.gate.set()
        for thread in asking:
            thread.join(10)
    assert replies == [Ok(), Ok()]
    assert len(service.executed) == 1


def test_one_character_is_served_in_order(server: ServiceServer, service: Counting) -> None:
    async def ask() -> None:
        async with AsyncServiceClient(server.endpoint) as client:
            await client.connect()
            await asyncio.gather(*(client.request(Step(ticks=n), "a") for n in range(1, 9)))

    asyncio.run(ask())
    assert service.executed == [("a", n) for n in range(1, 9)]
    assert not service.overlapped


def test_characters_do_not_wait_for_each_other(server: ServiceServer, service: Counting) -> None:
    async def ask() -> None:
        async with AsyncServiceClient(server.endpoint) as client:
            waiting = asyncio.create_task(client.request(PUSH, "slow"))
            await asyncio.to_thread(service.entered.acquire)
            await client.request(Step(ticks=5), "quick")
            assert not waiting.done()
            service.gate.set()
            await waiting

    asyncio.run(ask())
    assert service.executed == [("quick", 5), ("slow", 0)]


def test_a_future_frees_its_worker_and_character(server: ServiceServer, service: Counting) -> None:
    async def ask() -> None:
        async with AsyncServiceClient(server.endpoint) as client:
            waiting = [asyncio.create_task(client.request(TRACK, "a")) for _ in range(6)]
            for _ in waiting:
                await asyncio.to_thread(service.entered.acquire)
            await client.request(Step(ticks=5), "a")
            for number, future in enumerate(service.futures):
                future.set_result(TrackReply(accepted=True, tick=number))
            assert {reply.tick for reply in await asyncio.gather(*waiting)} == set(range(6))

    asyncio.run(ask())


def test_a_full_queue_says_so_and_health_still_answers(server: ServiceServer, service: Counting) -> None:
    async def ask() -> None:
        async with AsyncServiceClient(server.endpoint) as client:
            await client.connect()
            waiting = [asyncio.create_task(client.request(PUSH, f"c{n}")) for n in range(8)]
            for _ in range(4):
                await asyncio.to_thread(service.entered.acquire)
            with pytest.raises(OverloadedError) as caught:
                await client.request(Step(ticks=1), "late", message_id="try-again-later")
            assert caught.value.retryable
            service.gate.set()
            await asyncio.gather(*waiting)
            assert await client.request(Health()) == report()
            reply = await client.request(Step(ticks=1), "late", message_id="try-again-later")
            assert isinstance(reply, TrackReply)

    asyncio.run(ask())


def raw_request(endpoint: str, frames: list[bytes]) -> tuple[Envelope, Message]:
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    socket = context.socket(zmq.DEALER)
    try:
        socket.linger = 0
        socket.connect(endpoint)
        socket.send_multipart(frames)
        assert socket.poll(10_000), "no reply"
        return decode(socket.recv_multipart())
    finally:
        socket.close()
        context.term()


def test_an_expired_request_is_not_executed(server: ServiceServer, service: Counting) -> None:
    envelope = Envelope(
        type="Step", message_id="too-late-1", deadline_unix_s=time.time() - 1, instance_id=server.instance_id
    )
    answered, reply = raw_request(server.endpoint, encode(envelope, Step(ticks=1)))
    assert answered.message_id == "too-late-1"
    assert isinstance(reply, ErrorReply)
    assert (reply.code, reply.retryable) == ("deadline_exceeded", True)
    assert service.executed == []


def test_a_client_stops_waiting_at_its_deadline(client: ServiceClient, service: Counting) -> None:
    client.connect()
    with pytest.raises(DeadlineError):
        client.request(PUSH, "a", timeout_s=0.05)
    service.gate.set()
    assert client.ask(Step(ticks=1), TrackReply, "b").accepted


@pytest.mark.parametrize(
    "frames", [[b""], [b"x", b"y"], [b"MLP\x01\0\0\0\0", b"{}"], [b"\xff" * 9] * 40], ids=["none", "xy", "crc", "many"]
)
def test_garbage_gets_an_error_and_the_service_lives(
    server: ServiceServer, client: ServiceClient, frames: list[bytes]
) -> None:
    _, reply = raw_request(server.endpoint, frames)
    assert isinstance(reply, ErrorReply)
    assert reply.code == "malformed_message"
    assert client.ask(Step(ticks=1), TrackReply).accepted


def test_a_plan_of_the_wrong_shape_names_field_and_allowed(server: ServiceServer, service: Counting) -> None:
    frames = encode(Envelope(type="Track", message_id="wrong-shape", instance_id=server.instance_id), TRACK)
    header = json.loads(frames[1])
    header["arrays"][0]["shape"] = [3, 22, 2]
    text = json.dumps(header).encode()
    _, reply = raw_request(server.endpoint, [frames[0][:4] + zlib.crc32(text).to_bytes(4, "little"), text, *frames[2:]])
    assert isinstance(reply, ErrorReply)
    assert (reply.code, reply.field) == ("invalid_input", "positions_w_m")
    assert "(T, 22, 3)" in (reply.allowed or "")
    assert not service.futures


def test_without_a_handshake_nothing_is_done(server: ServiceServer, service: Counting) -> None:
    _, reply = raw_request(server.endpoint, encode(Envelope(type="Step", message_id="stranger"), Step(ticks=1)))
    assert isinstance(reply, ErrorReply)
    assert reply.code == "handshake_required"
    assert service.executed == []


def test_a_client_outlives_a_restart_of_the_service(service: Counting, free_endpoint: Callable[[], str]) -> None:
    endpoint = free_endpoint()
    first = service.server(endpoint).start()
    with ServiceClient(endpoint, "tracker") as client:
        client.request(Step(ticks=1), "a")
        first.stop()
        with pytest.raises(DeadlineError):
            client.request(Step(ticks=2), "a", timeout_s=0.1)
        with service.server(endpoint):
            assert client.ask(Step(ticks=3), TrackReply, "a").accepted
            assert client.restarts == 1
    assert [ticks for _, ticks in service.executed if ticks != 2] == [1, 3]


def test_nobody_there(free_endpoint: Callable[[], str]) -> None:
    with ServiceClient(free_endpoint(), "tracker") as client, pytest.raises(UnavailableError):
        client.request(Step(ticks=1), timeout_s=0.1)


def test_a_service_that_comes_late_is_found(service: Counting, free_endpoint: Callable[[], str]) -> None:
    endpoint = free_endpoint()
    with ServiceClient(endpoint, "tracker") as client:
        with pytest.raises(UnavailableError):
            client.connect(0.05)
        with service.server(endpoint):
            assert client.ask(Step(ticks=3), TrackReply, "a").accepted


@pytest.mark.parametrize(
    ("kind", "plugin", "field"),
    [("planner", None, "service"), ("tracker", "ppo", "plugin"), (None, "robot", "skeleton")],
)
def test_an_unfit_peer_is_refused_by_name(server: ServiceServer, kind: str, plugin: str, field: str) -> None:
    client = ServiceClient(server.endpoint, kind, plugin=plugin)  # type: ignore[arg-type]
    with client, pytest.raises(IncompatiblePeerError) as caught:
        client.connect()
    assert caught.value.field == field
    assert caught.value.allowed


@pytest.mark.parametrize("change", [{"protocol_version": 9}, {"skeleton": "g1"}])
def test_an_unfit_client_is_refused_by_name(server: ServiceServer, change: dict[str, object]) -> None:
    hello = Hello().model_copy(update=change)
    _, reply = raw_request(server.endpoint, encode(Envelope(type="Hello", message_id="wrong-hello"), hello))
    assert isinstance(reply, ErrorReply)
    assert (reply.code, reply.field) == ("incompatible_peer", next(iter(change)))


def test_old_replies_are_forgotten_within_the_limits(service: Counting) -> None:
    with service.server(replies_kept=3) as server, ServiceClient(server.endpoint) as client:
        for number in range(6):
            client.request(Step(ticks=1), message_id=f"message-{number}")
        client.request(Step(ticks=1), message_id="message-5")
        assert len(service.executed) == 6
        client.request(Step(ticks=1), message_id="message-0")
        assert len(service.executed) == 7


def test_a_taken_address_is_an_error(server: ServiceServer, service: Counting) -> None:
    with pytest.raises(zmq.ZMQError):
        service.server(server.endpoint).start()


def test_closing_an_async_client_ends_what_waits(server: ServiceServer, service: Counting) -> None:
    async def ask() -> None:
        client = AsyncServiceClient(server.endpoint)
        waiting = asyncio.create_task(client.request(PUSH, "a"))
        await asyncio.to_thread(service.entered.acquire)
        await client.close()
        with pytest.raises(UnavailableError):
            await waiting

    asyncio.run(ask())
