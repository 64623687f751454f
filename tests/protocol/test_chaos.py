"""A lockstep character behind a proxy that meddles with its messages does the same, tick by tick, as without."""

from __future__ import annotations

import uuid
from collections.abc import Iterator
from typing import TypeVar

import numpy as np
import pytest

from orchestrator.core.supervise import ServiceProcess
from shared.errors import MalformedMessageError
from shared.protocol.base import Message
from shared.protocol.control import Ok
from shared.protocol.messages import CloseCharacter, CreateCharacter, GetTicks, Impulse, StateFrame, Step, TickRange
from shared.protocol.transport import ServiceClient
from tests.orchestrator.support import running_service
from tests.protocol.chaos_proxy import FAULTS, ChaosProxy

STEPS = 60
SHARE = 0.15
TRIES = 8
Reply = TypeVar("Reply", bound=Message)


@pytest.fixture(scope="module")
def tracker() -> Iterator[ServiceProcess]:
    with running_service("tracker_service", "--trackers", "pd") as process:
        yield process


def asked(client: ServiceClient, message: Message, kind: type[Reply], name: str) -> Reply:
    """The reply. What is lost the client sends again by itself; what was corrupted is a clean error, and the same
    request, with the same message id, can be repeated without being carried out twice."""
    message_id = uuid.uuid4().hex
    for _ in range(TRIES):
        try:
            reply = client.request(message, name, timeout_s=30.0, message_id=message_id)
        except MalformedMessageError:
            continue
        assert isinstance(reply, kind)
        return reply
    raise AssertionError(f"{message.type} was corrupted {TRIES} times")


def performed(endpoint: str, name: str) -> TickRange:
    """Steps and pushes; the log of it."""
    with ServiceClient(endpoint, "tracker") as client:
        asked(client, CreateCharacter(pacing="lockstep", seed=3), StateFrame, name)
        for number in range(STEPS):
            if number % 10 == 5:
                asked(client, Impulse(body="spine3", impulse_w_ns=(0.0, 4.0, 0.0)), Ok, name)
            asked(client, Step(ticks=1), StateFrame, name)
        log = asked(client, GetTicks(start_tick=0, stop_tick=STEPS + 1), TickRange, name)
        asked(client, CloseCharacter(), Ok, name)
        return log


def test_the_result_is_the_same_whatever_happens_to_the_messages(tracker: ServiceProcess) -> None:
    wanted = performed(tracker.address, "undisturbed")
    with ChaosProxy(tracker.address, seed=11, share=SHARE) as proxy:
        found = performed(proxy.endpoint, "disturbed")
        assert set(proxy.done) == set(FAULTS), "every fault was there"
    for field in type(wanted).model_fields:
        a, b = getattr(wanted, field), getattr(found, field)
        assert np.array_equal(a, b) if isinstance(a, np.ndarray) else a == b, field
    assert len(found.body_pos_w_m) == len(wanted.body_pos_w_m) > STEPS
