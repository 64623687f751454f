"""Serving requests: ROUTER socket, worker threads, one reply a message id. Usage: shared/protocol/transport.py."""

from __future__ import annotations

import logging
import queue
import socket as os_socket
import threading
import time
import uuid
from collections import OrderedDict, deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import zmq
from pydantic import ValidationError

from shared import spans
from shared.errors import (
    DeadlineError,
    HandshakeRequiredError,
    IncompatiblePeerError,
    InvalidInputError,
    MotionLoopError,
    OverloadedError,
)
from shared.plugins.registry import current_name
from shared.protocol.base import PROTOCOL_VERSION, Message
from shared.protocol.codec import MAX_FRAMES, MAX_MESSAGE_BYTES, decode, encode, message_id_of
from shared.protocol.control import Envelope, Health, Hello, Welcome
from shared.protocol.errors import error_reply, invalid_input_from
from shared.protocol.security import (
    CurveKeys,
    bound_endpoint,
    check_bind,
    secure_server,
    start_authenticator,
    wildcard_port,
)
from shared.tracing import fields, traced

Handler = Callable[[Envelope, Any], "Message | Future[Message]"]
SKELETON_ID = "human22"
log = logging.getLogger(__name__)


@dataclass
class _Entry:
    """What is known of a message id: who asked what, who waits, and the reply once there is one."""

    asked: tuple[str, str | None]
    waiters: list[bytes]
    reply: list[bytes] | None = None


@dataclass
class _Job:
    envelope: Envelope
    message: Message
    done: threading.Event = field(default_factory=threading.Event)
    span: spans.Open | None = None


class ServiceServer:
    """A ROUTER socket whose requests are handled by worker threads.

    Requests of one character are handled one after the other, in order of arrival; those of different characters, and
    those without one, in parallel. A handler that returns a Future frees its worker and its character at once.
    Hello and Health have a thread of their own, so that a busy service still says how it is.

    Args:
        endpoint: tcp://127.0.0.1:0 or :* picks a free port; ipc://PATH; inproc://NAME.
        handlers: message type -> handler(envelope, message) -> reply or Future of it; MotionLoopErrors become
            ErrorReplies.
        welcome: makes the reply to Hello (its instance_id is filled in here).
        workers: threads for the handlers.
        max_pending: requests admitted and not yet answered; more are refused as overloaded.
        replies_kept, reply_bytes_kept: how many first replies are remembered for repeated message ids.
        context: needed for inproc (the client's too); an own one is made, and ended, without it.
        curve: keys; required to listen beyond this machine.
    """

    def __init__(
        self,
        endpoint: str,
        handlers: Mapping[type[Message], Handler],
        welcome: Callable[[Hello], Welcome],
        *,
        workers: int = 4,
        max_pending: int = 256,
        replies_kept: int = 2048,
        reply_bytes_kept: int = 64 * 2**20,
        context: zmq.Context[Any] | None = None,
        curve: CurveKeys | None = None,
    ):
        check_bind(endpoint, curve)
        self.instance_id = uuid.uuid4().hex
        self._wanted_endpoint = endpoint
        self._handlers = dict(handlers)
        self._welcome = welcome
        self._max_pending = max_pending
        self._replies_kept, self._reply_bytes_kept = replies_kept, reply_bytes_kept
        self._own_context = context is None
        self._context: zmq.Context[Any] = context if context is not None else zmq.Context()
        self._curve = curve
        self._workers = ThreadPoolExecutor(workers, thread_name_prefix="service")
        self._control = ThreadPoolExecutor(1, thread_name_prefix="service-control")
        self._lock = threading.Lock()
        self._entries: OrderedDict[str, _Entry] = OrderedDict()
        self._entry_bytes = 0
        self._lanes: dict[str, deque[_Job]] = {}
        self._pending = 0
        self._outbox: queue.SimpleQueue[list[bytes]] = queue.SimpleQueue()
        self._wake_in, self._wake_out = os_socket.socketpair()
        self._wake_in.setblocking(False)
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None
        self._authenticator: Any = None
        self.endpoint = endpoint

    def start(self) -> ServiceServer:
        """Bind and begin to serve; `endpoint` then holds the resolved port. Raises OSError-like zmq.ZMQError."""
        if self._curve is not None:
            self._authenticator = start_authenticator(self._context, self._curve)
        router = self._context.socket(zmq.ROUTER)
        router.linger = 0
        router.maxmsgsize = MAX_MESSAGE_BYTES
        router.set_hwm(1000)
        secure_server(router, self._curve)
        try:
            router.bind(wildcard_port(self._wanted_endpoint))
        except zmq.ZMQError:
            router.close()
            self._end()
            raise
        self.endpoint = bound_endpoint(router)
        self._thread = threading.Thread(target=self._serve, args=(router,), name="service-io", daemon=True)
        self._thread.start()
        return self

    def stop(self) -> None:
        """Stop receiving, let running handlers finish, close everything. Safe to call twice."""
        if self._stopping.is_set():
            return
        self._stopping.set()
        self._wake()
        if self._thread is not None:
            self._thread.join()
        self._end()

    def __enter__(self) -> ServiceServer:
        return self.start()

    def __exit__(self, *_: object) -> None:
        self.stop()

    @property
    def pending(self) -> int:
        """Requests admitted and not yet answered."""
        return self._pending

    def _end(self) -> None:
        self._stopping.set()
        self._workers.shutdown(wait=True, cancel_futures=True)
        self._control.shutdown(wait=True, cancel_futures=True)
        if self._authenticator is not None:
            self._authenticator.stop()
        if self._own_context:
            self._context.destroy(linger=0)
        self._wake_in.close()
        self._wake_out.close()

    # --- the socket's thread ---

    def _serve(self, router: zmq.Socket[Any]) -> None:
        poller = zmq.Poller()
        poller.register(router, zmq.POLLIN)
        poller.register(self._wake_out.fileno(), zmq.POLLIN)
        try:
            while not self._stopping.is_set():
                ready = dict(poller.poll(1000))
                if self._wake_out.fileno() in ready:
                    self._wake_out.recv(4096)
                while not self._outbox.empty():
                    router.send_multipart(self._outbox.get())
                if router in ready:
                    identity, frames = _receive(router)
                    self._receive(identity, frames)
        finally:
            router.close(linger=0)

    def _receive(self, identity: bytes, frames: list[bytes]) -> None:
        try:
            envelope, message = decode(frames)
        except MotionLoopError as error:
            self._refuse(identity, message_id_of(frames), None, error)
            return
        try:
            self._admit(identity, envelope, message)
        except MotionLoopError as error:
            self._refuse(identity, envelope.message_id, envelope, error)

    def _admit(self, identity: bytes, envelope: Envelope, message: Message) -> None:
        """Start the request, or answer it from what is known of its id. Raises what refuses it."""
        control = isinstance(message, Hello | Health)
        if not control and envelope.instance_id != self.instance_id:
            raise HandshakeRequiredError(
                "shake hands (Hello) with this service first: it is new or was restarted", field="instance_id"
            )
        if not control and type(message) not in self._handlers:
            raise InvalidInputError(
                f"this service does not take {message.type}",
                field="type",
                allowed=", ".join(sorted(kind.type for kind in self._handlers)),
            )
        asked = (message.type, envelope.character_id)
        with self._lock:
            entry = self._entries.get(envelope.message_id)
            if entry is not None:
                if entry.asked != asked:
                    raise InvalidInputError(
                        f"message id {envelope.message_id} was used for {entry.asked[0]}", field="message_id"
                    )
                if entry.reply is not None:
                    self._post([identity, *entry.reply])
                elif identity not in entry.waiters:
                    entry.waiters.append(identity)
                return
            _check_deadline(envelope)
            if self._pending >= self._max_pending:
                raise OverloadedError(f"{self._pending} requests are waiting already")
            self._pending += 1
            self._entries[envelope.message_id] = _Entry(asked, [identity])
            self._forget_old()
            job = _Job(envelope, message)
            lane = None if control else envelope.character_id
            if lane is not None and lane in self._lanes:
                self._lanes[lane].append(job)
                return
            if lane is not None:
                self._lanes[lane] = deque()
        (self._control if control else self._workers).submit(self._run, job, lane)

    def _refuse(self, identity: bytes, message_id: str, envelope: Envelope | None, error: MotionLoopError) -> None:
        reply = error_reply(error)
        self._post([identity, *encode(self._reply_envelope(reply, message_id, envelope), reply)])

    # --- worker threads ---

    def _run(self, job: _Job, lane: str | None) -> None:
        current: _Job | None = job
        while current is not None:
            self._handle(current)
            current = None
            if lane is not None:
                with self._lock:
                    if self._lanes[lane] and not self._stopping.is_set():
                        current = self._lanes[lane].popleft()
                    else:
                        del self._lanes[lane]

    def _handle(self, job: _Job) -> None:
        try:
            _check_deadline(job.envelope)
        except DeadlineError as error:
            self._finish(job, error, executed=False)
            return
        outcome: Message | MotionLoopError | Future[Message]
        try:
            asked = (job.message.type, job.envelope.message_id, job.envelope.character_id)
            with traced(job.envelope.trace_id), spans.within(span := spans.answered(*asked)):
                job.span = span
                outcome = self._handlers.get(type(job.message), self._shake_hands)(job.envelope, job.message)
        except Exception as error:  # noqa: BLE001 - the edge: whatever a handler raises, the sender gets a reply
            outcome = _as_motion_loop_error(error, job.message.type)
        if isinstance(outcome, Future):
            outcome.add_done_callback(lambda future: self._finish(job, _outcome(future, job.message.type)))
        else:
            self._finish(job, outcome)

    def _shake_hands(self, envelope: Envelope, hello: Hello) -> Welcome:
        if hello.protocol_version != PROTOCOL_VERSION:
            raise IncompatiblePeerError(
                f"{hello.client} speaks protocol version {hello.protocol_version}, this service {PROTOCOL_VERSION}",
                field="protocol_version",
                allowed=str(PROTOCOL_VERSION),
            )
        if hello.skeleton != SKELETON_ID:
            raise IncompatiblePeerError(
                f"{hello.client} uses skeleton {hello.skeleton!r}", field="skeleton", allowed=SKELETON_ID
            )
        welcome = self._welcome(hello)
        names = [str(plugin.get("name")) for plugin in welcome.plugins]
        if hello.plugin is not None and current_name(hello.plugin) not in names:
            raise IncompatiblePeerError(
                f"this {welcome.service} has no plug-in {hello.plugin!r}", field="plugin", allowed=", ".join(names)
            )
        return welcome.model_copy(update={"instance_id": self.instance_id})

    def _finish(self, job: _Job, outcome: Message | MotionLoopError, executed: bool = True) -> None:
        """Send the reply to all who wait for it, and remember it if the request was carried out."""
        message = error_reply(outcome) if isinstance(outcome, MotionLoopError) else outcome
        message_id = job.envelope.message_id
        spans.end(job.span, outcome.code if isinstance(outcome, MotionLoopError) else None)
        if log.isEnabledFor(logging.DEBUG):
            became = outcome.code if isinstance(outcome, MotionLoopError) else message.type
            with traced(job.envelope.trace_id):
                log.debug("%s", job.message.type, extra=fields(reply=became, character=job.envelope.character_id))
        try:
            frames = encode(self._reply_envelope(message, message_id, job.envelope), message)
        except MotionLoopError as error:
            message = error_reply(error)
            frames = encode(self._reply_envelope(message, message_id, job.envelope), message)
        with self._lock:
            self._pending -= 1
            entry = self._entries[message_id]
            waiters, entry.waiters = entry.waiters, []
            if executed:
                entry.reply = frames
                self._entry_bytes += _size(frames)
                self._forget_old()
            else:
                del self._entries[message_id]
            for identity in waiters:
                self._post([identity, *frames])

    # --- common ---

    def _forget_old(self) -> None:
        """Drop the oldest answered entries beyond the limits; requests under way stay."""
        for _ in range(len(self._entries)):
            if len(self._entries) <= self._replies_kept and self._entry_bytes <= self._reply_bytes_kept:
                return
            key, entry = next(iter(self._entries.items()))
            if entry.reply is None:
                self._entries.move_to_end(key)
            else:
                self._entry_bytes -= _size(entry.reply)
                del self._entries[key]

    def _reply_envelope(self, reply: Message, message_id: str, request: Envelope | None) -> Envelope:
        return Envelope(
            type=reply.type,
            message_id=message_id,
            character_id=request.character_id if request else None,
            sequence=request.sequence if request else 0,
            trace_id=request.trace_id if request else None,
            instance_id=self.instance_id,
        )

    def _post(self, frames: list[bytes]) -> None:
        self._outbox.put(frames)
        self._wake()

    def _wake(self) -> None:
        try:
            self._wake_in.send(b"\0")
        except BlockingIOError:
            return  # enough wake-ups are waiting already
        except OSError:
            log.debug("a reply came after the server was stopped")


def _receive(router: zmq.Socket[Any]) -> tuple[bytes, list[bytes]]:
    """Identity and frames; frames beyond the limit are read off the socket and thrown away."""
    identity = router.recv()
    frames: list[bytes] = []
    while router.getsockopt(zmq.RCVMORE):
        frame = router.recv()
        if len(frames) <= MAX_FRAMES:
            frames.append(frame)
    return identity, frames


def _check_deadline(envelope: Envelope) -> None:
    late_s = time.time() - (envelope.deadline_unix_s or float("inf"))
    if late_s > 0:
        raise DeadlineError(f"{envelope.type} came {late_s:.3f} s after its deadline", field="deadline_unix_s")


def _outcome(future: Future[Message], request: str) -> Message | MotionLoopError:
    if future.cancelled():
        return OverloadedError(f"{request} was cancelled")
    error = future.exception()
    return future.result() if error is None else _as_motion_loop_error(error, request)


def _as_motion_loop_error(error: BaseException, request: str) -> MotionLoopError:
    if isinstance(error, MotionLoopError):
        return error
    if isinstance(error, ValidationError):
        return invalid_input_from(error)
    log.error("%s failed", request, exc_info=error)
    return MotionLoopError(f"{request} failed: {type(error).__name__}: {error}")


def _size(frames: list[bytes]) -> int:
    return sum(len(frame) for frame in frames)
