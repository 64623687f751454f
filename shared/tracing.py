"""One id for all that comes of one request, from HTTP to the tick, and logs that carry it.

The id is of the present context (thread, task and what they start). The HTTP server sets it for each request, the
client of a service puts it into the envelope, the service sets it while it handles the message.
"""

from __future__ import annotations

import json
import logging
import sys
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, Literal

LogFormat = Literal["text", "json"]
_TRACE: ContextVar[str | None] = ContextVar("motionloop_trace", default=None)


def new_trace() -> str:
    """A fresh id: 32 hexadecimal digits, as W3C's Trace Context has them."""
    return uuid.uuid4().hex


def current_trace() -> str | None:
    """The id of the present context."""
    return _TRACE.get()


@contextmanager
def traced(trace_id: str | None) -> Iterator[None]:
    """Within it the id is `trace_id`; None leaves the one there is."""
    if trace_id is None:
        yield
        return
    token = _TRACE.set(trace_id)
    try:
        yield
    finally:
        _TRACE.reset(token)


def fields(**values: Any) -> dict[str, Any]:
    """For `extra=` of a log call: named values, which JSON lines show as fields of their own."""
    return {"fields": values}


class _Traced(logging.Filter):
    """Gives every record the id of the context it was made in."""

    def filter(self, record: logging.LogRecord) -> bool:
        record.trace_id = current_trace()
        return True


class JsonLines(logging.Formatter):
    """One JSON object a line: time, level, service, logger, message, trace_id, and the fields of `fields`.

    Args:
        service: who writes.
    """

    def __init__(self, service: str):
        super().__init__()
        self._service = service

    def format(self, record: logging.LogRecord) -> str:
        """The line."""
        line: dict[str, Any] = {
            "time": time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(record.created)) + f".{record.msecs:03.0f}Z",
            "level": record.levelname.lower(),
            "service": self._service,
            "logger": record.name,
            "message": record.getMessage(),
        }
        if (trace_id := getattr(record, "trace_id", None)) is not None:
            line["trace_id"] = trace_id
        line |= getattr(record, "fields", {})
        if record.exc_info:
            line["exception"] = self.formatException(record.exc_info)
        return json.dumps(line, default=str)


class _Lines(logging.Formatter):
    """Lines for people, one a message; the fields follow it as name=value."""

    def __init__(self) -> None:
        super().__init__("%(asctime)s %(levelname)s %(name)s: %(message)s")

    def formatMessage(self, record: logging.LogRecord) -> str:
        values = getattr(record, "fields", {})
        line = super().formatMessage(record) + "".join(f" {name}={value}" for name, value in values.items())
        return line.replace("\n", "\\n").replace("\r", "\\r")


def configure_logging(service: str, level: str, log_format: LogFormat) -> None:
    """Let this process log to standard error from `level` on, in lines for people or for machines."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonLines(service) if log_format == "json" else _Lines())
    handler.addFilter(_Traced())
    logging.basicConfig(level=level.upper(), handlers=[handler], force=True)
