"""Who may do what over HTTP: bearer tokens with a scope each.

`watch` reads, `command` also changes characters and episodes, `admin` also exchanges the services. Each scope holds
those before it. Without any token (loopback only, see the settings) everything is allowed.
"""

from __future__ import annotations

import secrets
from collections.abc import Sequence
from typing import Literal
from urllib.parse import urlsplit

from fastapi.exceptions import HTTPException
from starlette.requests import HTTPConnection

from orchestrator.api.settings import OrchestratorSettings

Scope = Literal["watch", "command", "admin"]
SCOPES: tuple[Scope, ...] = ("watch", "command", "admin")
READS = ("GET", "HEAD", "OPTIONS")
ADMIN_PATHS = ("/v1/services",)


class Tokens:
    """The server's tokens.

    Args:
        settings: `token` is the one for `admin`, `command_token` and `watch_token` are for the others.
    """

    def __init__(self, settings: OrchestratorSettings):
        given = ((settings.watch_token, "watch"), (settings.command_token, "command"), (settings.token, "admin"))
        self._tokens: list[tuple[bytes, Scope]] = [
            (token.get_secret_value().encode(), scope)  # type: ignore[misc] # mypy takes the literals for str
            for token, scope in given
            if token is not None
        ]

    @property
    def needed(self) -> bool:
        """Whether a request needs a token at all."""
        return bool(self._tokens)

    def scope_of(self, given: Sequence[bytes]) -> Scope | None:
        """The widest scope of those tokens that are ours; compared in constant time."""
        found: Scope | None = None
        for ours, scope in self._tokens:
            for token in given:
                if secrets.compare_digest(token, ours):
                    found = scope  # the tokens are in the order of their scopes
        return found


def needed_scope(method: str, path: str) -> Scope:
    """What a request needs."""
    if method in READS:
        return "watch"
    return "admin" if path.startswith(ADMIN_PATHS) else "command"


def bearer_of(connection: HTTPConnection) -> list[bytes]:
    """The token in the Authorization header, as a list of one or none."""
    kind, _, token = connection.headers.get("authorization", "").partition(" ")
    return [token.encode()] if kind.lower() == "bearer" and token else []


def check_access(connection: HTTPConnection, offered: Sequence[bytes] = ()) -> None:
    """Let a request through, or refuse it: 401 without one of the tokens, 403 with one whose scope is too narrow.

    Args:
        connection: the request; a WebSocket reads.
        offered: tokens that came otherwise than in the Authorization header.
    """
    tokens: Tokens = connection.app.state.tokens
    if not tokens.needed:
        return
    scope = tokens.scope_of([*bearer_of(connection), *offered])
    if scope is None:
        raise HTTPException(401, "a bearer token is needed", headers={"WWW-Authenticate": "Bearer"})
    wanted = needed_scope(connection.scope.get("method", "GET"), connection.scope["path"])
    if SCOPES.index(scope) < SCOPES.index(wanted):
        raise HTTPException(
            403,
            f"this token may {scope}; a token with the scope {wanted} is needed",
            headers={"WWW-Authenticate": f'Bearer error="insufficient_scope", scope="{wanted}"'},
        )


def of_another_origin(connection: HTTPConnection) -> bool:
    """Whether a page of another site sends this through somebody's browser."""
    origin = connection.headers.get("origin")
    return origin is not None and urlsplit(origin).netloc != connection.headers.get("host")


def check_request(connection: HTTPConnection) -> None:
    """For routes: `check_access`, and 403 for a page of another site that would change something.

    A browser keeps such a page from reading the reply, but a plain POST has its effect before.
    """
    if connection.scope.get("method") not in READS and of_another_origin(connection):
        raise HTTPException(403, "a page of another site may change nothing here")
    check_access(connection)
