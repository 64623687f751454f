"""State frames for whoever watches: PUB/SUB by character, old frames dropped. Usage: shared/protocol/transport.py."""

from __future__ import annotations

import threading
import uuid
from collections.abc import AsyncIterator
from typing import Any

import zmq
import zmq.asyncio

from shared.errors import MotionLoopError
from shared.protocol.codec import MAX_MESSAGE_BYTES, decode, encode
from shared.protocol.control import Envelope
from shared.protocol.messages import StateFrame
from shared.protocol.security import (
    CurveKeys,
    bound_endpoint,
    check_bind,
    closed_on_error,
    secure_client,
    secure_server,
    wildcard_port,
)

FRAMES_QUEUED = 8


def _topic(character_id: str) -> bytes:
    """Topics match by prefix; the bar keeps `a1` from matching `a10`."""
    return f"{character_id}|".encode()


class StatePublisher:
    """Socket of StateFrames; `publish` may be called from any thread and never blocks. A character that no one watches
    costs nothing: an XPUB socket tells who does.

    With CURVE keys the context must be that of a ServiceServer, whose authenticator decides who may connect.
    """

    def __init__(self, endpoint: str, *, context: zmq.Context[Any] | None = None, curve: CurveKeys | None = None):
        check_bind(endpoint, curve)
        self._own_context = context is None
        self._context: zmq.Context[Any] = context if context is not None else zmq.Context()
        self._lock = threading.Lock()
        self._sequence = 0
        self._watched: set[bytes] = set()
        self._socket = self._context.socket(zmq.XPUB)
        self._socket.linger = 0
        self._socket.sndhwm = FRAMES_QUEUED
        secure_server(self._socket, curve)
        try:
            self._socket.bind(wildcard_port(endpoint))
        except zmq.ZMQError:
            self.close()
            raise
        self.endpoint = bound_endpoint(self._socket)

    def publish(self, frame: StateFrame) -> None:
        """Send a frame to those who watch its character; slow ones miss it."""
        with self._lock:
            if self._socket.closed:
                return
            self._sequence += 1
            topic = _topic(frame.character_id)
            self._hear()
            if not any(topic.startswith(watched) for watched in self._watched):
                return
            envelope = Envelope(
                type=frame.type,
                message_id=uuid.uuid4().hex,
                character_id=frame.character_id,
                sequence=self._sequence,
            )
            self._socket.send_multipart([topic, *encode(envelope, frame)])

    def _hear(self) -> None:
        """Take in which topics are watched from now on, and which are not any more."""
        while self._socket.poll(0):
            said = self._socket.recv()
            if said[:1] == b"\x01":
                self._watched.add(said[1:])
            elif said[:1] == b"\x00":
                self._watched.discard(said[1:])

    def close(self) -> None:
        """Close the socket (and the context, if it is the publisher's own). Safe to call twice."""
        with self._lock:
            self._socket.close(linger=0)
            if self._own_context:
                self._context.destroy(linger=0)


def _set_up(socket: zmq.Socket[Any], endpoint: str, character_ids: tuple[str, ...], curve: CurveKeys | None) -> None:
    socket.linger = 0
    socket.maxmsgsize = MAX_MESSAGE_BYTES
    socket.rcvhwm = FRAMES_QUEUED
    socket.reconnect_ivl, socket.reconnect_ivl_max = 50, 1000
    secure_client(socket, curve)
    for character_id in character_ids:
        socket.subscribe(_topic(character_id))
    if not character_ids:
        socket.subscribe(b"")
    socket.connect(endpoint)


def _frame_of(frames: list[bytes]) -> StateFrame | None:
    """The state frame in a publication; None for anything else, since a lost frame is no loss to a watcher."""
    try:
        _, message = decode(frames[1:])
    except MotionLoopError:
        return None
    return message if isinstance(message, StateFrame) else None


class StateSubscriber:
    """Blocking watcher of some characters (none named: all)."""

    def __init__(
        self,
        endpoint: str,
        *character_ids: str,
        context: zmq.Context[Any] | None = None,
        curve: CurveKeys | None = None,
    ):
        self._own_context = context is None
        self._context: zmq.Context[Any] = context if context is not None else zmq.Context()
        self._socket = self._context.socket(zmq.SUB)
        with closed_on_error(self._socket, self._context if self._own_context else None):
            _set_up(self._socket, endpoint, character_ids, curve)

    def latest(self, timeout_s: float) -> dict[str, StateFrame]:
        """The newest frame of each character that has one, waiting up to `timeout_s` for the first."""
        newest: dict[str, StateFrame] = {}
        wait_ms = max(0, round(timeout_s * 1000))
        while self._socket.poll(0 if newest else wait_ms):
            frame = _frame_of(self._socket.recv_multipart())
            if frame is not None:
                newest[frame.character_id] = frame
        return newest

    def close(self) -> None:
        """Close the socket (and the context, if it is the subscriber's own)."""
        self._socket.close(linger=0)
        if self._own_context:
            self._context.destroy(linger=0)


class AsyncStateSubscriber:
    """asyncio watcher of some characters (none named: all): `async for frame in subscriber.frames()`."""

    def __init__(
        self,
        endpoint: str,
        *character_ids: str,
        context: zmq.Context[Any] | None = None,
        curve: CurveKeys | None = None,
    ):
        base: zmq.Context[Any] = context if context is not None else zmq.Context()
        self._own_context = base if context is None else None
        self._context = zmq.asyncio.Context(base)
        self._socket = self._context.socket(zmq.SUB)
        with closed_on_error(self._socket, self._own_context):
            _set_up(self._socket, endpoint, character_ids, curve)

    async def frames(self) -> AsyncIterator[StateFrame]:
        """Frames as they come; where several of a character wait, only the newest."""
        while True:
            newest: dict[str, StateFrame] = {}
            waiting = [await self._socket.recv_multipart()]
            while await self._socket.poll(0):
                waiting.append(await self._socket.recv_multipart())
            for frames in waiting:
                frame = _frame_of(frames)
                if frame is not None:
                    newest[frame.character_id] = frame
            for frame in newest.values():
                yield frame

    def close(self) -> None:
        """Close the socket (and the context, if it is the subscriber's own)."""
        self._socket.close(linger=0)
        if self._own_context is not None:
            self._own_context.destroy(linger=0)
