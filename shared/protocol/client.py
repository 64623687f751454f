"""Asking a service: DEALER clients, blocking and asyncio. Usage: shared/protocol/transport.py."""

from __future__ import annotations

import asyncio
import contextlib
import threading
import time
import uuid
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

import zmq
import zmq.asyncio

from shared import spans
from shared.errors import (
    DeadlineError,
    HandshakeRequiredError,
    IncompatiblePeerError,
    MotionLoopError,
    UnavailableError,
)
from shared.protocol.base import PROTOCOL_VERSION, Message
from shared.protocol.codec import MAX_MESSAGE_BYTES, decode, encode, message_id_of
from shared.protocol.control import Envelope, ErrorReply, Health, Hello, Welcome
from shared.protocol.errors import error_from
from shared.protocol.security import CurveKeys, closed_on_error, secure_client
from shared.protocol.server import SKELETON_ID
from shared.protocol.waiting import Waiting
from shared.tracing import current_trace

Kind = Literal["planner", "tracker"]
Reply = TypeVar("Reply", bound=Message)
DEFAULT_TIMEOUT_S = 10.0
HANDSHAKE_TIMEOUT_S = 5.0
RESEND_S, CONTROL_RESEND_S = 1.0, 0.25
"""What is lost costs about so much time; a service that is busy answers a repeated request once. Hello and Health are
small, and a service has a thread of its own for them: they find out early that it is there again."""
LONGEST_RECONNECT_MS = 250


@dataclass(frozen=True)
class Peer:
    """What a client wants at the other end.

    Attributes:
        endpoint: where it listens.
        kind: which service it must be; None for any.
        plugin: a plug-in it must offer, or None.
        curve: keys, where the service listens beyond its machine.
        name: says in the service's messages who asks.
    """

    endpoint: str
    kind: Kind | None = None
    plugin: str | None = None
    curve: CurveKeys | None = None
    name: str = "motionloop"

    def hello(self) -> Hello:
        """The first message on the connection."""
        return Hello(client=self.name, plugin=self.plugin)

    def accept(self, reply: Message) -> Welcome:
        """The Welcome, if the peer fits; IncompatiblePeerError names what does not."""
        if not isinstance(reply, Welcome):
            raise IncompatiblePeerError(f"{self.endpoint} answered Hello with {reply.type}")
        if reply.protocol_version != PROTOCOL_VERSION:
            raise IncompatiblePeerError(
                f"the {reply.service} at {self.endpoint} speaks protocol version {reply.protocol_version}",
                field="protocol_version",
                allowed=str(PROTOCOL_VERSION),
            )
        if self.kind is not None and reply.service != self.kind:
            raise IncompatiblePeerError(
                f"{self.endpoint} is a {reply.service}, not a {self.kind}", field="service", allowed=self.kind
            )
        wanted = self.plugin or reply.default_plugin
        for plugin in reply.plugins:
            if plugin.get("name") == wanted and plugin.get("skeleton") != SKELETON_ID:
                raise IncompatiblePeerError(
                    f"plug-in {wanted!r} at {self.endpoint} uses skeleton {plugin.get('skeleton')!r}",
                    field="skeleton",
                    allowed=SKELETON_ID,
                )
        return reply

    def connect(self, socket: zmq.Socket[Any]) -> None:
        """Set up and connect a DEALER socket."""
        socket.linger = 0
        socket.maxmsgsize = MAX_MESSAGE_BYTES
        socket.reconnect_ivl, socket.reconnect_ivl_max = 50, LONGEST_RECONNECT_MS
        socket.heartbeat_ivl, socket.heartbeat_timeout = 2000, 6000
        secure_client(socket, self.curve)
        socket.connect(self.endpoint)


def _envelope(
    message: Message, message_id: str | None, character_id: str | None, sequence: int, timeout_s: float,
    trace_id: str | None, welcome: Welcome | None,
) -> Envelope:  # fmt: skip
    return Envelope(
        type=message.type,
        message_id=message_id or uuid.uuid4().hex,
        character_id=character_id,
        sequence=sequence,
        deadline_unix_s=time.time() + timeout_s,
        trace_id=trace_id or current_trace(),
        instance_id=welcome.instance_id if welcome else None,
    )


def _result(reply: Message) -> Message:
    if isinstance(reply, ErrorReply):
        raise error_from(reply)
    return reply


def _check_type(reply: Message, reply_type: type[Reply]) -> Reply:
    if not isinstance(reply, reply_type):
        raise IncompatiblePeerError(f"the reply is a {reply.type}", field="type", allowed=reply_type.type)
    return reply


def _needs_handshake(message: Message) -> bool:
    return not isinstance(message, Hello | Health)


def _resend_s(message: Message) -> float:
    return RESEND_S if _needs_handshake(message) else CONTROL_RESEND_S


class ServiceClient:
    """Blocking client; may be shared between threads, which take turns.

    A request is sent again with the same message id while no reply comes (the service answers it once), so a restart
    of the service or a lost message costs time, not correctness. After a restart it shakes hands again by itself and
    `restarts` counts up.
    """

    def __init__(
        self,
        endpoint: str,
        kind: Kind | None = None,
        *,
        plugin: str | None = None,
        context: zmq.Context[Any] | None = None,
        curve: CurveKeys | None = None,
        name: str = "motionloop",
    ):
        self.peer = Peer(endpoint, kind, plugin, curve, name)
        self.welcome: Welcome | None = None
        self.restarts = 0
        self._own_context = context is None
        self._context: zmq.Context[Any] = context if context is not None else zmq.Context()
        self._socket = self._context.socket(zmq.DEALER)
        self._lock = threading.Lock()
        self._sequence = 0
        with closed_on_error(self._socket, self._context if self._own_context else None):
            self.peer.connect(self._socket)

    def connect(self, timeout_s: float = HANDSHAKE_TIMEOUT_S) -> Welcome:
        """Shake hands now. Raises UnavailableError if nobody answers, IncompatiblePeerError if the peer is unfit."""
        with self._lock:
            return self._shake_hands(time.monotonic() + timeout_s)

    def request(
        self,
        message: Message,
        character_id: str | None = None,
        *,
        timeout_s: float = DEFAULT_TIMEOUT_S,
        message_id: str | None = None,
        trace_id: str | None = None,
    ) -> Message:
        """The reply to a message. Raises the error of an ErrorReply; DeadlineError, UnavailableError without one."""
        until = time.monotonic() + timeout_s
        message_id = message_id or uuid.uuid4().hex
        with self._lock:
            self._sequence += 1
            while True:
                if self.welcome is None and _needs_handshake(message):
                    self._shake_hands(min(until, time.monotonic() + HANDSHAKE_TIMEOUT_S))
                left_s = until - time.monotonic()
                sent = _envelope(
                    message, message_id, character_id, self._sequence, left_s, trace_id, self.welcome
                )  # fmt: skip
                try:
                    return _result(self._exchange(sent, message, until))
                except HandshakeRequiredError:
                    self.welcome = None
                    self.restarts += 1

    def ask(
        self,
        message: Message,
        reply_type: type[Reply],
        character_id: str | None = None,
        *,
        timeout_s: float = DEFAULT_TIMEOUT_S,
    ) -> Reply:
        """Like `request`, with the type of the reply checked."""
        return _check_type(self.request(message, character_id, timeout_s=timeout_s), reply_type)

    def close(self) -> None:
        """Close the socket (and the context, if it is the client's own). Safe to call twice."""
        with self._lock:
            self._socket.close(linger=0)
            if self._own_context:
                self._context.destroy(linger=0)

    def __enter__(self) -> ServiceClient:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _shake_hands(self, until: float) -> Welcome:
        hello = self.peer.hello()
        sent = _envelope(hello, None, None, 0, until - time.monotonic(), None, None)
        try:
            reply = self._exchange(sent, hello, until)
        except DeadlineError as error:
            raise UnavailableError(f"nobody answers at {self.peer.endpoint}", field="endpoint") from error
        self.welcome = self.peer.accept(_result(reply))
        return self.welcome

    def _exchange(self, envelope: Envelope, message: Message, until: float) -> Message:
        frames = encode(envelope, message)
        while True:
            if self._socket.closed:
                raise UnavailableError("the client is closed")
            with contextlib.suppress(zmq.Again):  # the queue to a peer that is away is full: tried again below
                self._socket.send_multipart(frames, flags=zmq.NOBLOCK)
            resend_at = time.monotonic() + _resend_s(message)
            while (left_s := min(until, resend_at) - time.monotonic()) > 0:
                if self._socket.poll(max(1, round(left_s * 1000))):
                    reply = _reply_to(envelope.message_id, self._socket.recv_multipart())
                    if reply is not None:
                        return reply
            if time.monotonic() >= until:
                raise DeadlineError(f"no reply to {message.type} from {self.peer.endpoint} before the deadline")


def _reply_to(message_id: str, frames: list[bytes]) -> Message | None:
    """The reply in the frames; None if it answers something else. A damaged reply raises, naming what is wrong."""
    try:
        envelope, reply = decode(frames)
    except MotionLoopError:
        if message_id_of(frames) == message_id:
            raise
        return None
    return reply if envelope.message_id == message_id else None


class AsyncServiceClient:
    """asyncio client; many requests may be under way at once. Same promises as ServiceClient. What is under way when
    a service that was away is heard again is sent again at once.

    Make it, use it and `await close()` it within one event loop.
    """

    def __init__(
        self,
        endpoint: str,
        kind: Kind | None = None,
        *,
        plugin: str | None = None,
        context: zmq.Context[Any] | None = None,
        curve: CurveKeys | None = None,
        name: str = "motionloop",
    ):
        self.peer = Peer(endpoint, kind, plugin, curve, name)
        self.welcome: Welcome | None = None
        self.restarts = 0
        base: zmq.Context[Any] = context if context is not None else zmq.Context()
        self._own_context = base if context is None else None
        self._context = zmq.asyncio.Context(base)
        self._socket = self._context.socket(zmq.DEALER)
        with closed_on_error(self._socket, self._own_context):
            self.peer.connect(self._socket)
        self._waiting = Waiting()
        self._reader: asyncio.Task[None] | None = None
        self._handshake_lock = asyncio.Lock()
        self._sequence = 0

    @property
    def in_doubt(self) -> bool:
        """Whether the last deadline passed in silence, and nothing was heard of the service since."""
        return self._waiting.in_doubt

    async def connect(self, timeout_s: float = HANDSHAKE_TIMEOUT_S) -> Welcome:
        """Shake hands now. Raises UnavailableError if nobody answers, IncompatiblePeerError if the peer is unfit."""
        async with self._handshake_lock:
            return await self._shake_hands(time.monotonic() + timeout_s)

    async def request(
        self,
        message: Message,
        character_id: str | None = None,
        *,
        timeout_s: float = DEFAULT_TIMEOUT_S,
        message_id: str | None = None,
        trace_id: str | None = None,
    ) -> Message:
        """The reply to a message. Raises the error of an ErrorReply; DeadlineError, UnavailableError without one."""
        until = time.monotonic() + timeout_s
        message_id = message_id or uuid.uuid4().hex
        self._sequence += 1
        sequence = self._sequence
        while True:
            welcome = await self._welcomed(until) if _needs_handshake(message) else None
            left_s = until - time.monotonic()
            sent = _envelope(message, message_id, character_id, sequence, left_s, trace_id, welcome)
            try:
                with spans.asked(message.type, message_id, character=character_id, endpoint=self.peer.endpoint):
                    return _result(await self._exchange(sent, message, until))
            except HandshakeRequiredError:
                if self.welcome is welcome:
                    self.welcome = None
                    self.restarts += 1

    async def ask(
        self,
        message: Message,
        reply_type: type[Reply],
        character_id: str | None = None,
        *,
        timeout_s: float = DEFAULT_TIMEOUT_S,
    ) -> Reply:
        """Like `request`, with the type of the reply checked."""
        return _check_type(await self.request(message, character_id, timeout_s=timeout_s), reply_type)

    async def close(self) -> None:
        """End waiting requests with UnavailableError and close the socket. Safe to call twice."""
        if self._reader is not None:
            self._reader.cancel()
            await asyncio.gather(self._reader, return_exceptions=True)
            self._reader = None
        self._waiting.end(UnavailableError("the client was closed"))
        self._socket.close(linger=0)
        if self._own_context is not None:
            self._own_context.destroy(linger=0)

    async def __aenter__(self) -> AsyncServiceClient:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def _welcomed(self, until: float) -> Welcome:
        async with self._handshake_lock:  # the first request shakes hands, those behind it find it done
            if self.welcome is not None:
                return self.welcome
            return await self._shake_hands(min(until, time.monotonic() + HANDSHAKE_TIMEOUT_S))

    async def _shake_hands(self, until: float) -> Welcome:
        hello = self.peer.hello()
        sent = _envelope(hello, None, None, 0, until - time.monotonic(), None, None)
        try:
            reply = await self._exchange(sent, hello, until)
        except DeadlineError as error:
            raise UnavailableError(f"nobody answers at {self.peer.endpoint}", field="endpoint") from error
        self.welcome = self.peer.accept(_result(reply))
        self._waiting.ask_again()  # whatever is under way went to the service's life before this one
        return self.welcome

    async def _exchange(self, envelope: Envelope, message: Message, until: float) -> Message:
        if self._socket.closed:
            raise UnavailableError("the client is closed")
        if self._reader is None or self._reader.done():
            self._reader = asyncio.create_task(self._read(), name="motionloop-client-reader")
        frames = encode(envelope, message)
        future = self._waiting.add(envelope.message_id)
        try:
            while True:
                with contextlib.suppress(zmq.Again):  # the queue to a peer that is away is full: tried again below
                    await self._socket.send_multipart(frames, flags=zmq.NOBLOCK)
                wait_s = min(until - time.monotonic(), _resend_s(message))
                reply = await self._waiting.reply(future, max(wait_s, 0.0))
                if reply is not None:
                    return reply
                if time.monotonic() >= until:
                    self._waiting.in_doubt = True
                    raise DeadlineError(f"no reply to {message.type} from {self.peer.endpoint} before the deadline")
        finally:
            self._waiting.remove(envelope.message_id)

    async def _read(self) -> None:
        while True:
            self._waiting.take(await self._socket.recv_multipart())
