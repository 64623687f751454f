"""State frames over real sockets: a watcher sees its own character, and the newest frame first."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time

import pytest
import zmq

from shared.errors import InvalidInputError
from shared.protocol.messages import StateFrame
from shared.protocol.transport import AsyncStateSubscriber, StatePublisher, StateSubscriber
from tests.protocol.samples import SAMPLES


def state_frame(character_id: str, tick: int) -> StateFrame:
    sample = next(sample for sample in SAMPLES if isinstance(sample, StateFrame))
    return sample.model_copy(update={"character_id": character_id, "tick": tick})


def published_until_seen(publisher: StatePublisher, watching: StateSubscriber, ids: list[str]) -> dict[str, StateFrame]:
    """Frames seen after publishing until the subscription has taken effect."""
    seen: dict[str, StateFrame] = {}
    give_up = time.monotonic() + 10
    tick = 0
    while not seen and time.monotonic() < give_up:
        tick += 1
        for character_id in ids:
            publisher.publish(state_frame(character_id, tick))
        seen = watching.latest(0.05)
    return seen


def test_a_watcher_sees_its_character_only() -> None:
    publisher = StatePublisher("tcp://127.0.0.1:0")
    watching = StateSubscriber(publisher.endpoint, "a1")
    try:
        assert set(published_until_seen(publisher, watching, ["a10", "a1", "b"])) == {"a1"}
    finally:
        watching.close()
        publisher.close()


def test_frames_that_no_one_watches_are_not_even_written() -> None:
    def unwritable(character_id: str) -> StateFrame:
        return state_frame(character_id, 1).model_copy(update={"tracking_error_m": math.nan})

    publisher = StatePublisher("tcp://127.0.0.1:0")
    watching = StateSubscriber(publisher.endpoint, "b")
    try:
        publisher.publish(unwritable("a1"))
        watching.close()
        watching = StateSubscriber(publisher.endpoint, "a1")
        published_until_seen(publisher, watching, ["a1"])
        with pytest.raises(InvalidInputError, match="JSON"):
            publisher.publish(unwritable("a1"))
        publisher.publish(unwritable("a10"))
        watching.close()
        give_up = time.monotonic() + 10
        while time.monotonic() < give_up:
            with contextlib.suppress(InvalidInputError):
                publisher.publish(unwritable("a1"))
                break
            time.sleep(0.01)
        else:
            raise AssertionError("who has gone is still written for")
    finally:
        watching.close()
        publisher.close()


def test_a_slow_watcher_gets_the_newest() -> None:
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    publisher = StatePublisher("inproc://states", context=context)
    watching = StateSubscriber("inproc://states", context=context)
    try:
        published_until_seen(publisher, watching, ["a"])
        for tick in range(100, 105):
            publisher.publish(state_frame("a", tick))
        assert watching.latest(1.0)["a"].tick == 104
    finally:
        watching.close()
        publisher.close()
        context.term()


def test_frames_in_asyncio() -> None:
    async def watch() -> StateFrame:
        publisher = StatePublisher("tcp://127.0.0.1:0")
        watching = AsyncStateSubscriber(publisher.endpoint, "a")
        frames = watching.frames()
        first = asyncio.ensure_future(anext(frames))
        try:
            for tick in range(1000):
                publisher.publish(state_frame("a", tick))
                done, _ = await asyncio.wait({first}, timeout=0.02)
                if done:
                    return first.result()
            raise AssertionError("no frame came")
        finally:
            first.cancel()
            watching.close()
            publisher.close()

    assert asyncio.run(watch()).character_id == "a"
