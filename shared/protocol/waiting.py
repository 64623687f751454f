"""Requests of an asyncio client that wait for their replies, and whether the peer is there."""

from __future__ import annotations

import asyncio
from typing import Any

from shared.errors import MotionLoopError
from shared.protocol.base import Message
from shared.protocol.codec import decode, message_id_of


class Waiting:
    """The requests under way.

    What was sent while the peer was away may be lost, and would be sent again only after a while each. So once anything
    is heard from a peer that had been silent, all of them are sent again at once; the service answers each only once.

    Attributes:
        in_doubt: whether the last that is known of the peer is that it let a deadline pass in silence.
    """

    def __init__(self) -> None:
        self._futures: dict[str, asyncio.Future[Message]] = {}
        self._again: asyncio.Future[None] | None = None
        self._silent = False
        self.in_doubt = False

    def add(self, message_id: str) -> asyncio.Future[Message]:
        """The reply to come."""
        future: asyncio.Future[Message] = asyncio.get_running_loop().create_future()
        self._futures[message_id] = future
        return future

    def remove(self, message_id: str) -> None:
        """Nobody waits for it any more."""
        self._futures.pop(message_id, None)

    async def reply(self, future: asyncio.Future[Message], seconds: float) -> Message | None:
        """The reply; None when it is to be asked for again: after so long, or as soon as a silent peer is heard.

        Raises the error of a reply that was damaged.
        """
        if self._again is None or self._again.done():
            self._again = asyncio.get_running_loop().create_future()
        # Waiting ends with the first: a reply, or the news that the peer is there again.
        either: set[asyncio.Future[Any]] = {future, self._again}
        await asyncio.wait(either, timeout=seconds, return_when=asyncio.FIRST_COMPLETED)
        if future.done():
            return future.result()
        if not self._again.done():
            self._silent = True
        return None

    def take(self, frames: list[bytes]) -> None:
        """A message has come from the peer."""
        self.in_doubt = False
        try:
            envelope, reply = decode(frames)
        except MotionLoopError as error:
            damaged = self._futures.get(message_id_of(frames))
            if damaged is not None and not damaged.done():
                damaged.set_exception(error)
        else:
            future = self._futures.get(envelope.message_id)
            if future is not None and not future.done():
                future.set_result(reply)
        if self._silent:
            self.ask_again()

    def ask_again(self) -> None:
        """Have all that wait send their requests again now."""
        self._silent = False
        if self._again is not None and not self._again.done():
            self._again.set_result(None)

    def end(self, error: MotionLoopError) -> None:
        """No reply will come: all get this error instead."""
        for future in self._futures.values():
            if not future.done():
                future.set_exception(error)
