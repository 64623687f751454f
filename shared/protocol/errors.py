"""Errors to ErrorReply and back, and pydantic's complaints as InvalidInputError."""

from __future__ import annotations

from collections.abc import Iterator

from pydantic import ValidationError

from shared.errors import InvalidInputError, MotionLoopError
from shared.protocol.control import ErrorReply

_LIMITS = {
    "ge": ">=", "gt": ">", "le": "<=", "lt": "<", "min_length": "length >=", "max_length": "length <=",
    "multiple_of": "multiple of", "pattern": "matching", "expected": "one of",
}  # fmt: skip


def invalid_input_from(error: ValidationError) -> InvalidInputError:
    """The first complaint of pydantic as one error that names the field in dotted form and what is allowed."""
    first = error.errors(include_url=False)[0]
    field = ".".join(str(part) for part in first["loc"]) or None
    text = first["msg"].removeprefix("Value error, ")
    allowed: str | None = None
    if "allowed: " in text:
        text, allowed = text.split("; allowed: ", 1)
    elif context := first.get("ctx"):
        allowed = ", ".join(f"{_LIMITS[key]} {value}" for key, value in context.items() if key in _LIMITS) or None
    return InvalidInputError(f"{field}: {text}" if field else text, field=field, allowed=allowed)


def error_reply(error: MotionLoopError) -> ErrorReply:
    """The reply that carries an error to the peer."""
    return ErrorReply(
        code=error.code, message=error.message, retryable=error.retryable, field=error.field, allowed=error.allowed
    )


def error_from(reply: ErrorReply) -> MotionLoopError:
    """The error that an ErrorReply carries; an unknown code gives a plain MotionLoopError with that code."""
    for kind in _kinds(MotionLoopError):
        if kind.code == reply.code:
            break
    else:
        kind = MotionLoopError
    error = kind(reply.message, field=reply.field, allowed=reply.allowed)
    error.code, error.retryable = reply.code, reply.retryable
    return error


def _kinds(base: type[MotionLoopError]) -> Iterator[type[MotionLoopError]]:
    yield base
    for kind in base.__subclasses__():
        yield from _kinds(kind)
