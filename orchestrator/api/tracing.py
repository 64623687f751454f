"""Every request has a trace id: the caller's, or a fresh one; the reply names it and the log has a line for it."""

from __future__ import annotations

import logging
import re
import time

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from shared.tracing import fields, new_trace, traced

HEADER = "x-trace-id"
_PARENT = re.compile(r"[0-9a-f]{2}-([0-9a-f]{32})-[0-9a-f]{16}-[0-9a-f]{2}")
_ID = re.compile(r"[A-Za-z0-9._-]{8,64}")
log = logging.getLogger(__name__)


def trace_of(headers: Headers) -> str:
    """The id in `traceparent` (W3C Trace Context) or `x-trace-id`; a fresh one where neither holds a sound one."""
    parent = _PARENT.fullmatch(headers.get("traceparent", "").strip())
    if parent is not None and parent[1] != "0" * 32:
        return parent[1]
    given = headers.get(HEADER, "").strip()
    return given if _ID.fullmatch(given) else new_trace()


class Tracing:
    """ASGI middleware that gives each request and WebSocket its trace id."""

    def __init__(self, app: ASGIApp):
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        trace_id, began_s, status = trace_of(Headers(scope=scope)), time.perf_counter(), 0

        async def answer(message: Message) -> None:
            nonlocal status
            if message["type"] in ("http.response.start", "websocket.accept"):
                status = message.get("status", 101)
                MutableHeaders(scope=message)[HEADER] = trace_id
            await send(message)

        with traced(trace_id):
            try:
                await self._app(scope, receive, answer)
            finally:
                ms = round((time.perf_counter() - began_s) * 1e3, 2)
                asked = f"{scope.get('method', 'WS')} {scope['path']}"
                log.info("%s", asked, extra=fields(status=status, ms=ms))
