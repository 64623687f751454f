"""Every request has a trace id: the caller's, or a fresh one; the reply names it and the log has a line for it."""

from __future__ import annotations

import logging
import re
import time

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from shared import spans
from shared.tracing import fields, new_trace, traced

HEADER = "x-trace-id"
_PARENT = re.compile(r"[0-9a-f]{2}-([0-9a-f]{32})-([0-9a-f]{16})-[0-9a-f]{2}")
_ID = re.compile(r"[A-Za-z0-9._-]{8,64}")
log = logging.getLogger(__name__)


def _parent_of(headers: Headers) -> re.Match[str] | None:
    parent = _PARENT.fullmatch(headers.get("traceparent", "").strip())
    return parent if parent is not None and parent[1] != "0" * 32 else None


def trace_of(headers: Headers) -> str:
    """The id in `traceparent` (W3C Trace Context) or `x-trace-id`; a fresh one where neither holds a sound one."""
    parent = _parent_of(headers)
    if parent is not None:
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
        headers = Headers(scope=scope)
        trace_id, began_s, status = trace_of(headers), time.perf_counter(), 0
        parent, method = _parent_of(headers), scope.get("method", "WS")

        async def answer(message: Message) -> None:
            nonlocal status
            if message["type"] in ("http.response.start", "websocket.accept"):
                status = message.get("status", 101)
                MutableHeaders(scope=message)[HEADER] = trace_id
            await send(message)

        with traced(trace_id):
            span = spans.begin(method, "server", parent=int(parent[2], 16) if parent else None)
            try:
                with spans.within(span):
                    await self._app(scope, receive, answer)
            finally:
                ms = round((time.perf_counter() - began_s) * 1e3, 2)
                log.info("%s", f"{method} {scope['path']}", extra=fields(status=status, ms=ms))
                if span is not None:
                    route = getattr(scope.get("route"), "path", None)
                    span.rename(f"{method} {route}" if route else method)
                    span.end(**_said(method, scope["path"], route, status))


def _said(method: str, path: str, route: str | None, status: int) -> dict[str, str | int | None]:
    """Attributes by OpenTelemetry's conventions."""
    return {
        "http.request.method": method,
        "url.path": path,
        "http.route": route,
        "http.response.status_code": status,
        "error": f"status {status}" if status >= 500 else None,
    }
