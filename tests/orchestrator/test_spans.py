"""Spans for OpenTelemetry: of one process in memory, and of all three at a collector."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

import httpx
import pytest

from orchestrator.core.supervise import Stack
from shared import spans
from shared.tracing import traced
from tests.orchestrator.support import light

sdk = pytest.importorskip("opentelemetry.sdk.trace", reason="spans need the extra otel")
TRACE = "0af7651916cd43dd8448eb211c80319c"
PARENT = f"00-{TRACE}-b7ad6b7169203331-01"


@pytest.fixture
def finished() -> Iterator[Callable[[], dict[str, Any]]]:
    """The spans of this process that have ended, by name."""
    from opentelemetry.sdk.trace.export import SimpleSpanProcessor
    from opentelemetry.sdk.trace.export.in_memory_span_exporter import InMemorySpanExporter

    kept = InMemorySpanExporter()
    provider = sdk.TracerProvider(shutdown_on_exit=False)
    provider.add_span_processor(SimpleSpanProcessor(kept))
    with spans.recording(spans.Recorder(provider)):
        yield lambda: {span.name: span for span in kept.get_finished_spans()}


def test_a_span_belongs_to_its_trace_and_to_what_led_to_it(finished: Callable[[], dict[str, Any]]) -> None:
    with traced(TRACE):
        request = spans.begin("POST", "server", parent=0xB7AD6B7169203331)
        assert request is not None
        with spans.within(request), spans.asked("PlanRequest", "message-1", character="c", endpoint=None):
            pass
        request.end(error=None)
        with traced(TRACE), spans.asked("Track", "message-2"):  # a loop of its own, later: no span is in use
            answer = spans.answered("Track", "message-2")  # as the other process would
            assert answer is not None
            with spans.within(answer):
                tick = spans.later("tick", tick=42)
            answer.end(error="conflict")
    assert tick is not None
    begun = tick()  # the clock's thread has no trace
    assert begun is not None
    begun.end()
    made = finished()
    assert set(made) == {"POST", "PlanRequest", "Track", "tick"}
    assert {span.context.trace_id for span in made.values()} == {int(TRACE, 16)}
    assert made["POST"].parent.span_id == 0xB7AD6B7169203331
    assert made["PlanRequest"].parent.span_id == made["POST"].context.span_id
    assert made["PlanRequest"].context.span_id == spans.span_number("message-1")
    assert dict(made["PlanRequest"].attributes) == {"character": "c"}
    assert made["Track"].parent.span_id == made["POST"].context.span_id, "the asking end ended last"
    assert made["tick"].attributes["tick"] == 42


def test_an_answer_belongs_to_its_request_and_says_what_went_wrong(finished: Callable[[], dict[str, Any]]) -> None:
    with traced("order-17"):
        answer = spans.answered("Track", "message-2", "c")
        assert answer is not None
        answer.end(error="conflict")
    (made,) = finished().values()
    assert made.parent.span_id == spans.span_number("message-2") and made.parent.is_remote
    assert made.context.trace_id == spans.trace_number("order-17") != 0
    assert (made.status.status_code.name, made.status.description) == ("ERROR", "conflict")


def test_what_only_looks_and_what_is_of_no_trace_has_no_span(finished: Callable[[], dict[str, Any]]) -> None:
    assert spans.begin("a block") is None
    with traced(TRACE), spans.asked("Observe", "message-1"):
        assert spans.answered("Observe", "message-1") is None
    assert finished() == {}


def test_without_a_recorder_nothing_is_made() -> None:
    with traced(TRACE), spans.asked("Track", "message-1") as nothing:
        assert nothing is None
        assert spans.later("tick") is None


@pytest.mark.parametrize(
    "environment",
    [
        {},
        {"OTEL_SERVICE_NAME": "x"},
        {"OTEL_EXPORTER_OTLP_ENDPOINT": "http://127.0.0.1:1", "OTEL_SDK_DISABLED": "true"},
        {"OTEL_EXPORTER_OTLP_ENDPOINT": "http://127.0.0.1:1", "OTEL_TRACES_EXPORTER": "none"},
        {"OTEL_TRACES_EXPORTER": "zipkin"},
    ],
)
def test_spans_are_recorded_only_where_they_are_asked_for(environment: dict[str, str]) -> None:
    assert spans.recorder_of("planner", environment) is None


@dataclass
class Collector:
    """An OTLP collector over HTTP: what each service has sent."""

    url: str = ""
    by_service: dict[str, list[Any]] = field(default_factory=lambda: defaultdict(list))

    def spans(self, service: str, trace: str) -> list[Any]:
        return [span for span in list(self.by_service[service]) if span.trace_id.hex() == trace]

    def wait_for(self, service: str, trace: str, name: str) -> Any:
        until = time.monotonic() + 90.0
        while time.monotonic() < until:
            found = [span for span in self.spans(service, trace) if span.name == name]
            if found:
                return found[0]
            time.sleep(0.05)
        raise AssertionError(f"no span {name} of {service}; there are {dict(self.by_service)}")


@pytest.fixture
def collector(monkeypatch: pytest.MonkeyPatch) -> Iterator[Collector]:
    """On a port of its own, with the variables that name it."""
    from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import ExportTraceServiceRequest

    kept = Collector()

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["content-length"]))
            for sent in ExportTraceServiceRequest.FromString(body).resource_spans:
                (name,) = [each.value.string_value for each in sent.resource.attributes if each.key == "service.name"]
                kept.by_service[name] += [span for scope in sent.scope_spans for span in scope.spans]
            self.send_response(200)
            self.end_headers()

        def log_message(self, *_: Any) -> None:
            """Quiet."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = Thread(target=server.serve_forever)
    thread.start()
    kept.url = f"http://127.0.0.1:{server.server_port}"
    for name, value in (
        ("EXPORTER_OTLP_ENDPOINT", kept.url),
        ("EXPORTER_OTLP_COMPRESSION", "none"),
        ("BSP_SCHEDULE_DELAY", "50"),
    ):
        monkeypatch.setenv(f"OTEL_{name}", value)
    yield kept
    server.shutdown()
    server.server_close()
    thread.join()


def test_a_command_can_be_followed_from_http_over_the_plan_to_the_tick(collector: Collector, tmp_path: Path) -> None:
    with Stack(light(tmp_path)) as stack, httpx.Client(base_url=stack.url, timeout=60.0) as http:
        made = http.post("/v1/characters", json={"pacing": "lockstep"}).json()
        path = f"/v1/characters/{made['id']}"
        told = http.post(f"{path}/commands", json={"text": "a person stands."}, headers={"traceparent": PARENT})
        assert told.status_code < 300
        http.post(f"{path}/steps", json={"ticks": 30})
        tick = collector.wait_for("motionloop-tracker", TRACE, "tick")
        taken = collector.wait_for("motionloop-tracker", TRACE, "Track")
        given = collector.wait_for("motionloop-orchestrator", TRACE, "Track")
        planned = collector.wait_for("motionloop-planner", TRACE, "PlanRequest")
        asked = collector.wait_for("motionloop-orchestrator", TRACE, "PlanRequest")
        request = collector.wait_for(
            "motionloop-orchestrator", TRACE, "POST /v1/characters/{character_id}/commands"
        )  # fmt: skip
    assert request.parent_span_id.hex() == PARENT.split("-")[2]
    assert asked.parent_span_id == given.parent_span_id == request.span_id
    assert planned.parent_span_id == asked.span_id
    assert taken.parent_span_id == given.span_id
    assert tick.parent_span_id == taken.span_id
    assert tick.start_time_unix_nano >= taken.start_time_unix_nano
