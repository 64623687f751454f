"""Errors of the client: what the server refused, and what to do when it is not there."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import httpx

from shared.errors import DeadlineError, MotionLoopError, UnavailableError


class ServerProblem(MotionLoopError):
    """The server answered with a problem (RFC 9457).

    Attributes:
        status: HTTP status. code, field, allowed, retryable: as the server gave them.
        errors: every refused value, where there are several.
    """

    def __init__(self, status: int, problem: Mapping[str, Any]):
        detail = str(problem.get("detail") or problem.get("title") or f"HTTP {status}")
        super().__init__(detail, field=problem.get("field"), allowed=problem.get("allowed"))
        self.status = status
        self.code = str(problem.get("code", "http_error"))
        self.retryable = bool(problem.get("retryable", False))
        self.errors: list[dict[str, Any]] = list(problem.get("errors") or [])


def problem_of(status: int, body: bytes) -> ServerProblem:
    """The error of a reply that is no success."""
    try:
        problem = json.loads(body)
    except ValueError:
        problem = None
    if not isinstance(problem, dict):
        problem = {"detail": body[:200].decode(errors="replace")}
    return ServerProblem(status, problem)


def no_connection(url: str, error: Exception) -> MotionLoopError:
    """What a broken or missing connection means for the user."""
    reason = str(error) or type(error).__name__
    if isinstance(error, httpx.TimeoutException | TimeoutError):
        return DeadlineError(f"{url} did not answer in time: try again, or give the client a longer timeout_s")
    if isinstance(error, httpx.ConnectError | OSError):
        return UnavailableError(
            f"no server at {url} ({reason}): start one with `motionloop serve all`, "
            "or set MOTIONLOOP_URL to the address of yours"
        )
    return UnavailableError(
        f"the connection to {url} broke ({reason}): see whether the server still runs, and try again"
    )


@contextmanager
def usable_proxies() -> Iterator[None]:
    """Raise UnavailableError where the environment names a proxy that httpx cannot use."""
    try:
        yield
    except (ImportError, ValueError) as error:
        raise UnavailableError(f"the proxy that the environment names cannot be used: {error}", field="url") from error
