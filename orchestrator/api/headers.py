"""Headers of every reply that keep browsers from making more of it than it is."""

from __future__ import annotations

from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Content-Security-Policy": "default-src 'none'; frame-ancestors 'none'",
    "Cache-Control": "no-store",
}
"""Where a route says nothing else; the page has a policy of its own (orchestrator/api/page.py)."""
INTERACTIVE = ("/docs", "/redoc")
"""FastAPI's pages load their scripts from a public server, which a policy would keep from them."""


class SafeHeaders:
    """ASGI middleware that adds the headers which a reply lacks."""

    def __init__(self, app: ASGIApp):
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        async def answer(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    if name != "Content-Security-Policy" or scope["path"] not in INTERACTIVE:
                        headers.setdefault(name, value)
            await send(message)

        await self._app(scope, receive, answer)
