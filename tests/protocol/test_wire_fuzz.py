"""Mutated messages against each service as a process: it answers, stays healthy and does not grow without end.

The seed is fixed. `MOTIONLOOP_FUZZ=100000 pytest -s` sends more and shows what they cost.
"""

from __future__ import annotations

import os
import random
import struct
import time
import uuid
import zlib
from collections.abc import Iterator

import psutil
import pytest
import zmq

from orchestrator.core.supervise import ServiceProcess
from shared.protocol.codec import MAGIC, encode
from shared.protocol.control import Envelope, Health, HealthReport
from shared.protocol.transport import ServiceClient
from tests.orchestrator.support import running_service
from tests.protocol.samples import SAMPLES

MESSAGES = int(os.environ.get("MOTIONLOOP_FUZZ", "3000"))
MEGABYTE = 2**20
GROWTH_BYTES = 128 * MEGABYTE
"""Room for the replies that a service remembers (64 MiB) and what its allocator keeps."""
SLOW = {"Render", "Hello", "Step"}
"""Not sent as they are: a video takes seconds, and so may a step of many ticks."""


@pytest.fixture(params=["planner", "tracker"])
def service(request: pytest.FixtureRequest) -> Iterator[ServiceProcess]:
    extra = ["--plugins", "stand"] if request.param == "planner" else ["--trackers", "kinematic"]
    with running_service(f"{request.param}_service", *extra) as process:
        yield process


def mutated(frames: list[bytes], draw: random.Random) -> list[bytes]:
    """The message with one to four things done to it; half of the time the header's checksum is made right again."""
    frames = list(frames)
    for _ in range(draw.randint(1, 4)):
        place = draw.randrange(len(frames))
        frame = bytearray(frames[place])
        what = draw.randrange(7)
        if what == 0 and frame:
            frame[draw.randrange(len(frame))] = draw.randrange(256)
        elif what == 1:
            frame = frame[: draw.randrange(len(frame) + 1)]
        elif what == 2:
            frame += draw.randbytes(draw.randint(1, 64))
        elif what == 3 and frame:
            at = draw.randrange(len(frame))
            frame[at:at] = draw.choice([b"-1", b"1e999", b"null", b"[", b'"', b"\xff", b"9" * 40, b"{}"])
        elif what == 4:
            frames.insert(place, draw.randbytes(draw.randint(0, 32)))
            continue
        elif what == 5 and len(frames) > 1:
            del frames[place]
            continue
        elif what == 6:
            other = draw.randrange(len(frames))
            frames[place], frames[other] = frames[other], frames[place]
            continue
        frames[place] = bytes(frame)
    if len(frames) > 1 and draw.random() < 0.5:
        frames[0] = struct.pack("<4sI", MAGIC, zlib.crc32(frames[1]))
    return frames


def test_mutated_messages_leave_a_service_healthy(service: ServiceProcess) -> None:
    draw = random.Random(20261126)
    with ServiceClient(service.address) as client, zmq.Context() as context:
        instance = client.connect().instance_id
        memory = psutil.Process(service.pid)
        samples = [sample for sample in SAMPLES if sample.type not in SLOW]
        answered = 0
        with context.socket(zmq.DEALER) as dealer:
            dealer.linger, dealer.rcvtimeo = 0, 10_000
            dealer.connect(service.address)
            before = None
            for number in range(MESSAGES):
                message = draw.choice(samples)
                envelope = Envelope(
                    type=message.type, message_id=uuid.UUID(int=draw.getrandbits(128)).hex, character_id="fuzzed",
                    instance_id=instance, deadline_unix_s=time.time() + 5.0,
                )  # fmt: skip
                dealer.send_multipart(mutated(encode(envelope, message), draw))
                if number % 50 == 49:  # in step with the service, so that nothing is lost in a full queue
                    answered += drained(dealer)
                    report = client.ask(Health(), HealthReport, timeout_s=30.0)
                    assert report.status == "ok"
                if number == MESSAGES // 3:
                    before = memory.memory_info().rss
        assert answered > MESSAGES // 2
        assert before is not None
        after = memory.memory_info().rss
        print(f"{MESSAGES} messages, {answered} replies; {before / MEGABYTE:.0f} MB after a third of them,", end=" ")
        print(f"{after / MEGABYTE:.0f} MB after all")
        assert after - before < GROWTH_BYTES
    assert service.alive


def drained(dealer: zmq.Socket[bytes]) -> int:
    """How many replies have come; some messages cannot be told from others, and have none of their own."""
    count = 0
    while dealer.poll(20):
        dealer.recv_multipart()
        count += 1
    return count
