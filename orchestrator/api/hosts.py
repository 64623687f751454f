"""Whose requests are answered: those addressed to this server by one of its own names.

A server on loopback needs no token, since only this machine can reach it. A page of anywhere can reach it too, through
the browser of whoever sits here, once its own name is made to point at 127.0.0.1 (DNS rebinding); to the browser it is
then of the same origin. What gives it away is the name that it asks for.
"""

from __future__ import annotations

from collections.abc import Collection
from ipaddress import ip_address
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from orchestrator.api.problems import problem_response
from orchestrator.rest import Problem
from shared.protocol.security import is_loopback

FORBIDDEN = 403
CLOSED = 4403


def host_of(header: str) -> str:
    """The name or address in a Host header, without its port and in lower case; empty for what is none."""
    try:
        return (urlsplit(f"//{header}").hostname or "").rstrip(".")
    except ValueError:
        return ""


def _over_ip(scope: Scope) -> bool:
    """Whether a request came to an IP address: no name can be made to point at a Unix socket, or into this process."""
    try:
        ip_address((scope.get("server") or ("",))[0])
    except ValueError:
        return False
    return True


class HostGuard:
    """ASGI middleware that turns away requests for other hosts than loopback and `allowed`.

    Args:
        app: what it guards.
        allowed: more names, without ports.
    """

    def __init__(self, app: ASGIApp, allowed: Collection[str] = ()):
        self._app = app
        self._allowed = frozenset(name.lower().rstrip(".") for name in allowed)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket") or not _over_ip(scope):
            await self._app(scope, receive, send)
            return
        host = host_of(Headers(scope=scope).get("host", ""))
        if is_loopback(host) or host in self._allowed:
            await self._app(scope, receive, send)
        elif scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": CLOSED, "reason": "this host is not served here"})
        else:
            problem = Problem(
                title="forbidden host",
                status=FORBIDDEN,
                detail=f"this server does not answer for the host {host!r}",
                instance=str(scope["path"]),
                code="forbidden_host",
                field="host",
                allowed="localhost, 127.0.0.1 and what --allowed-hosts names",
            )
            await problem_response(problem)(scope, receive, send)
