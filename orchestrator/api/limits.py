"""What one caller, and all together, may ask of the server: refused early and cheaply, with when to try again."""

from __future__ import annotations

import math
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass

from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from orchestrator.api.problems import problem_response
from orchestrator.rest import Problem

KEPT_CALLERS = 4096
BURST_S = 2.0
"""A caller that was quiet may ask for as much at once as for so long at the rate."""
TRY_AGAIN_LATER = 1013
PROBES = ("/healthz", "/readyz", "/metrics")
"""Answered whatever goes on, lest a busy server be taken for a dead one."""


@dataclass(frozen=True)
class Limits:
    """Attributes:
    body_bytes: of one request.
    rate_per_s: requests of one caller (by address) a second, over two seconds.
    requests: under way at once, streams of events among them.
    streams: WebSockets at once.
    """

    body_bytes: int
    rate_per_s: float
    requests: int
    streams: int


class Buckets:
    """A bucket of tokens a caller; bounded: those who asked longest ago are forgotten, and begin anew with a full one.

    Args:
        rate_per_s: tokens that come in a second.
        clock: seconds that only go forward.
    """

    def __init__(self, rate_per_s: float, clock: Callable[[], float] = time.monotonic):
        self._rate_per_s = rate_per_s
        self._full = max(rate_per_s * BURST_S, 1.0)
        self._clock = clock
        self._left: OrderedDict[str, tuple[float, float]] = OrderedDict()

    def wait_s(self, caller: str) -> float:
        """0 and one token less, or how long until there is one."""
        now_s = self._clock()
        left, since_s = self._left.pop(caller, (self._full, now_s))
        left = min(left + (now_s - since_s) * self._rate_per_s, self._full)
        wait_s = 0.0 if left >= 1.0 else (1.0 - left) / self._rate_per_s
        self._left[caller] = (left - 1.0 if wait_s == 0.0 else left, now_s)
        while len(self._left) > KEPT_CALLERS:
            self._left.popitem(last=False)
        return wait_s


class Limiter:
    """ASGI middleware: 413 for too large a body, 429 for a caller that asks too often, 503 when all ask too much.

    Args:
        app: what it guards.
        limits: how much is allowed.
        clock: seconds that only go forward.
    """

    def __init__(self, app: ASGIApp, limits: Limits, clock: Callable[[], float] = time.monotonic):
        self._app = app
        self._limits = limits
        self._buckets = Buckets(limits.rate_per_s, clock)
        self._requests = self._streams = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "websocket":
            await self._stream(scope, receive, send)
        elif scope["type"] == "http" and scope["path"] not in PROBES:
            await self._request(scope, receive, send)
        else:
            await self._app(scope, receive, send)

    async def _request(self, scope: Scope, receive: Receive, send: Send) -> None:
        wait_s = self._buckets.wait_s(caller_of(scope))
        if wait_s > 0:
            said = f"more than {self._limits.rate_per_s:g} requests a second"
            await _refuse(429, "rate_limited", said, scope, receive, send, wait_s)
            return
        if self._requests >= self._limits.requests:
            said = f"{self._requests} requests are under way already"
            await _refuse(503, "overloaded", said, scope, receive, send, 1.0)
            return
        length = Headers(scope=scope).get("content-length", "0")
        if not length.isdecimal() or int(length) > self._limits.body_bytes:
            await _refuse(413, "too_large", _too_large(self._limits.body_bytes), scope, receive, send)
            return
        self._requests += 1
        try:
            await self._app(scope, _bounded(receive, self._limits.body_bytes), send)
        finally:
            self._requests -= 1

    async def _stream(self, scope: Scope, receive: Receive, send: Send) -> None:
        if self._streams >= self._limits.streams or self._buckets.wait_s(caller_of(scope)) > 0:
            await receive()  # the message that asks to connect: closing in answer to it is an HTTP refusal
            await send(
                {"type": "websocket.close", "code": TRY_AGAIN_LATER, "reason": "too many streams: try again later"}
            )
            return
        self._streams += 1
        try:
            await self._app(scope, receive, send)
        finally:
            self._streams -= 1


def caller_of(scope: Scope) -> str:
    """The address that a request comes from."""
    client = scope.get("client")
    return str(client[0]) if client else ""


def _too_large(limit: int) -> str:
    return f"the body has more than {limit} bytes"


def _bounded(receive: Receive, limit: int) -> Receive:
    """`receive` that raises 413 once more than `limit` bytes of a body without a length have come."""
    seen = 0

    async def counted() -> Message:
        nonlocal seen
        message = await receive()
        seen += len(message.get("body", b""))
        if seen > limit:
            raise HTTPException(413, _too_large(limit))
        return message

    return counted


async def _refuse(
    status: int, code: str, said: str, scope: Scope, receive: Receive, send: Send, retry_s: float | None = None
) -> None:
    problem = Problem(
        type=f"urn:motionloop:{code}", title=code.replace("_", " "), status=status, detail=said,
        instance=str(scope["path"]), code=code, retryable=retry_s is not None,
    )  # fmt: skip
    response = problem_response(problem)
    if retry_s is not None:
        response.headers["Retry-After"] = str(max(math.ceil(retry_s), 1))
    await response(scope, receive, send)
