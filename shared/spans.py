"""Spans for OpenTelemetry (extra `otel`): a request over HTTP, the messages it leads to, the tick of its plan.

A span is of the trace whose id `shared.tracing` carries. Nothing more goes over the wire: the span of a request between
services has an id made of the message's, so that the service knows what its own span belongs to.
"""

from __future__ import annotations

import hashlib
import logging
import os
import secrets
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from threading import Thread
from typing import TYPE_CHECKING, Any, Literal

from shared.tracing import current_trace, traced

if TYPE_CHECKING:
    from opentelemetry.sdk.trace import TracerProvider

Kind = Literal["server", "client", "internal"]
ROOTS_KEPT = 4096
CLOSE_S = 2.0
WATCHING = frozenset({"Hello", "Health", "Observe", "GetTicks", "TakeSnapshot"})
"""Messages that only look, some thirty times a second: no spans of theirs."""
_ASK = ("OTEL_EXPORTER_OTLP_ENDPOINT", "OTEL_EXPORTER_OTLP_TRACES_ENDPOINT", "OTEL_TRACES_EXPORTER")
log = logging.getLogger(__name__)


def trace_number(trace_id: str) -> int:
    """The 128 bits of an id; of one that is not 32 hexadecimal digits, those of its hash."""
    try:
        number = int(trace_id, 16) if len(trace_id) == 32 else 0
    except ValueError:
        number = 0
    return number or int.from_bytes(hashlib.sha256(trace_id.encode()).digest()[:16], "big")


def span_number(message_id: str) -> int:
    """The 64 bits by which the span of a message is known at both ends."""
    return int.from_bytes(hashlib.sha256(message_id.encode()).digest()[:8], "big") or 1


class Open:
    """A span under way; `end` it once."""

    def __init__(self, span: Any):
        self.span = span

    def end(self, **attributes: Any) -> None:
        """It ends now. Attributes that are None are left out; `error` marks it as failed."""
        from opentelemetry.trace import Status, StatusCode

        if attributes.get("error") is not None:
            self.span.set_status(Status(StatusCode.ERROR, str(attributes["error"])))
        self.span.set_attributes(_clean(attributes))
        self.span.end()

    def rename(self, name: str) -> None:
        """Another name, once it is known."""
        self.span.update_name(name)


class Recorder:
    """Makes spans of a provider of OpenTelemetry's.

    Args:
        provider: with its exporter. Its `id_generator` is exchanged for one that takes the ids from here.
    """

    def __init__(self, provider: TracerProvider):
        self._ids: ContextVar[tuple[int, int | None] | None] = ContextVar("motionloop_span_ids", default=None)
        self._provider = provider
        provider.id_generator = _Ids(self._ids)
        self._tracer = provider.get_tracer("motionloop")
        self._roots: OrderedDict[int, Any] = OrderedDict()

    def begin(
        self, name: str, kind: Kind, own: int | None, parent: int | None, attributes: Mapping[str, Any]
    ) -> Open | None:
        """Start a span of the present trace; None where there is no trace.

        Args:
            own, parent: ids of spans. Without a parent it is the span of this context, if that is of the same trace,
                else the first span of the trace in this process.
        """
        from opentelemetry import trace

        trace_id = current_trace()
        if trace_id is None:
            return None
        number = trace_number(trace_id)
        above = trace.get_current_span().get_span_context()
        if parent is not None:
            flags = trace.TraceFlags(trace.TraceFlags.SAMPLED)
            above = trace.SpanContext(number, parent, is_remote=True, trace_flags=flags)
        elif above.trace_id != number:
            above = self._roots.get(number)
        context = trace.set_span_in_context(trace.NonRecordingSpan(above)) if above is not None else trace.Context()
        token = self._ids.set((number, own))
        try:
            kinds = {"server": trace.SpanKind.SERVER, "client": trace.SpanKind.CLIENT}
            span = self._tracer.start_span(
                name, context, kinds.get(kind, trace.SpanKind.INTERNAL), attributes=_clean(attributes)
            )
        finally:
            self._ids.reset(token)
        if number not in self._roots:
            self._roots[number] = span.get_span_context()
            if len(self._roots) > ROOTS_KEPT:
                self._roots.popitem(last=False)
        return Open(span)

    def close(self) -> None:
        """Hand over what is left; a collector that does not answer holds the end up for two seconds at most."""
        handing_over = Thread(target=self._provider.shutdown, name="spans", daemon=True)
        handing_over.start()
        handing_over.join(CLOSE_S)


class _Ids:
    """OpenTelemetry's interface of an IdGenerator."""

    def __init__(self, ids: ContextVar[tuple[int, int | None] | None]):
        self._ids = ids

    def generate_trace_id(self) -> int:
        """That of the trace."""
        given = self._ids.get()
        return given[0] if given is not None else secrets.randbits(128) or 1

    def generate_span_id(self) -> int:
        """The one asked for, or any."""
        given = self._ids.get()
        return (given[1] if given is not None else None) or secrets.randbits(64) or 1

    def is_trace_id_random(self) -> bool:
        """A caller may have chosen it."""
        return False


_IN_USE: list[Recorder] = []
"""The recorder of this process, as the root logger is one of the process."""


@contextmanager
def recording(recorder: Recorder | None) -> Iterator[None]:
    """Within it spans go to `recorder`; None: nowhere, and they cost nothing."""
    if recorder is None:
        yield
        return
    _IN_USE.append(recorder)
    try:
        yield
    finally:
        _IN_USE.remove(recorder)
        recorder.close()


def recorder_of(service: str, environment: Mapping[str, str] = os.environ) -> Recorder | None:
    """What the standard OTEL_ variables ask for; None if they ask for nothing, or the extra `otel` is not installed.

    Args:
        service: name of this process, unless OTEL_SERVICE_NAME has another.
    """
    asked = [name for name in _ASK if environment.get(name)]
    exporter = environment.get("OTEL_TRACES_EXPORTER") or "otlp"
    if not asked or exporter == "none" or environment.get("OTEL_SDK_DISABLED", "").lower() == "true":
        return None
    try:
        from opentelemetry.sdk.resources import Resource
        from opentelemetry.sdk.trace import TracerProvider
        from opentelemetry.sdk.trace.export import BatchSpanProcessor
    except ImportError:
        log.warning("%s is set, but OpenTelemetry is not installed: pip install 'motionloop[otel]'", asked[0])
        return None
    made = _exporter(exporter)
    if made is None:
        log.warning("OTEL_TRACES_EXPORTER=%s is not known here; there are otlp, console and none", exporter)
        return None
    name = environment.get("OTEL_SERVICE_NAME") or f"motionloop-{service}"
    provider = TracerProvider(resource=Resource.create({"service.name": name}), shutdown_on_exit=False)
    provider.add_span_processor(BatchSpanProcessor(made))
    return Recorder(provider)


def _exporter(name: str) -> Any:
    if name == "console":
        import sys

        from opentelemetry.sdk.trace.export import ConsoleSpanExporter

        return ConsoleSpanExporter(out=sys.stderr)
    if name == "otlp":
        from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter

        return OTLPSpanExporter()
    return None


def begin(
    name: str, kind: Kind = "internal", own: int | None = None, parent: int | None = None, **attributes: Any
) -> Open | None:
    """Start a span, which the caller ends; None where none is recorded.

    Args:
        own, parent: ids of spans, where they are known (`span_number`).
        attributes: None is left out.
    """
    return _IN_USE[-1].begin(name, kind, own, parent, attributes) if _IN_USE else None


def asked(message_type: str, message_id: str, **attributes: Any) -> AbstractContextManager[Open | None]:
    """The span of a request between services, at the end that asks, around the wait for its reply."""
    if not _IN_USE or message_type in WATCHING:
        return nullcontext()
    return around(begin(message_type, "client", span_number(message_id), **attributes))


def answered(message_type: str, message_id: str, character_id: str | None = None) -> Open | None:
    """Its span at the end that answers; to be ended by `end`."""
    if not _IN_USE or message_type in WATCHING:
        return None
    return begin(message_type, "server", parent=span_number(message_id), character=character_id)


def end(opened: Open | None, error: str | None = None) -> None:
    """End a span, if there is one."""
    if opened is not None:
        opened.end(error=error)


@contextmanager
def within(opened: Open | None) -> Iterator[None]:
    """Spans begun within it belong to `opened`, which goes on after it."""
    if opened is None:
        yield
        return
    from opentelemetry import trace

    with trace.use_span(opened.span, record_exception=False, set_status_on_exception=False):
        yield


@contextmanager
def around(opened: Open | None) -> Iterator[Open | None]:
    """`within`, and its end with the block; what the block raises is its error."""
    error: str | None = None
    try:
        with within(opened):
            yield opened
    except BaseException as raised:
        error = f"{type(raised).__name__}: {raised}"
        raise
    finally:
        end(opened, error)


def _clean(attributes: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in attributes.items() if value is not None}


def later(name: str, **attributes: Any) -> Callable[[], Open | None] | None:
    """Begins a span of the present one when it is called, in whatever thread; None where none is recorded."""
    trace_id = current_trace()
    if not _IN_USE or trace_id is None:
        return None
    from opentelemetry import trace

    parent = trace.get_current_span().get_span_context().span_id or None

    def call() -> Open | None:
        with traced(trace_id):
            return begin(name, parent=parent, **attributes)

    return call
