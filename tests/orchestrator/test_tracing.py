"""One trace id from the HTTP request to the tick at which its plan enters, in the logs of all three processes."""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import pytest
from starlette.datastructures import Headers

from orchestrator.api.tracing import HEADER, trace_of
from orchestrator.core.supervise import Stack
from shared.tracing import JsonLines, configure_logging, current_trace, fields, traced
from tests.orchestrator.support import light

JSON_LOGS = ("--log-level", "debug", "--log-format", "json")
PARENT = "00-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-01"


@pytest.fixture
def root_logger() -> Iterator[None]:
    """Put the root logger back as it was."""
    root = logging.getLogger()
    handlers, level = list(root.handlers), root.level
    yield
    root.handlers[:] = handlers
    root.setLevel(level)


def test_a_command_can_be_followed_to_its_tick(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    options = light(tmp_path)
    options = replace(
        options, planner_args=(*options.planner_args, *JSON_LOGS), tracker_args=JSON_LOGS, orchestrator_args=JSON_LOGS
    )
    with Stack(options) as stack, httpx.Client(base_url=stack.url, timeout=60.0) as http:
        made = http.post("/v1/characters", json={"pacing": "lockstep"}, headers={HEADER: "the-making"})
        assert made.headers[HEADER] == "the-making"
        path = f"/v1/characters/{made.json()['id']}"
        told = http.post(f"{path}/commands", json={"text": "a person stands."}, headers={"traceparent": PARENT})
        trace = told.headers[HEADER]
        assert trace == "0af7651916cd43dd8448eb211c80319c"
        assert http.post(f"{path}/steps", json={"ticks": 6}).headers[HEADER] not in (trace, "the-making")
        refused = http.post("/v1/characters", json={"pacing": "slow"}, headers={HEADER: "a-refusal"})
        assert (refused.status_code, refused.headers[HEADER]) == (422, "a-refusal")
    lines = [json.loads(line) for line in capfd.readouterr().err.splitlines() if line.startswith("{")]
    mine = [line for line in lines if line.get("trace_id") == trace]
    assert {line["service"] for line in mine} == {"orchestrator", "planner", "tracker"}

    def found(service: str, message: str) -> dict[str, Any]:
        return next(line for line in mine if (line["service"], line["message"]) == (service, message))

    assert found("orchestrator", f"POST {path}/commands")["status"] == told.status_code
    assert found("planner", "PlanRequest")["reply"] == "Plan"
    entered = found("tracker", "plan taken")
    assert entered["character"] == path.rpartition("/")[2]
    assert entered["enters_at_tick"] >= told.json()["tick"]
    assert any(line.get("trace_id") == "the-making" and line["message"] == "CreateCharacter" for line in lines)
    assert any(line.get("trace_id") == "a-refusal" and line["status"] == 422 for line in lines)


@pytest.mark.parametrize(
    ("headers", "wanted"),
    [
        ({"traceparent": PARENT, HEADER: "another-one"}, "0af7651916cd43dd8448eb211c80319c"),
        ({HEADER: "order.17_b-9"}, "order.17_b-9"),
        ({"traceparent": f"00-{'0' * 32}-b7ad6b7169203331-01", HEADER: "order-17"}, "order-17"),
    ],
)
def test_a_callers_id_is_taken(headers: dict[str, str], wanted: str) -> None:
    assert trace_of(Headers(headers)) == wanted


@pytest.mark.parametrize("given", ["", "short", "x" * 65, 'quo"te-12345', "new\tline-12345"])
def test_an_unsound_id_is_replaced(given: str) -> None:
    found = trace_of(Headers({HEADER: given}))
    assert found != given
    assert len(found) == 32


def test_an_id_holds_within_its_block_only() -> None:
    assert current_trace() is None
    with traced("outer-id"):
        with traced(None):
            assert current_trace() == "outer-id"
        with traced("inner-id"):
            assert current_trace() == "inner-id"
        assert current_trace() == "outer-id"
    assert current_trace() is None


@pytest.mark.usefixtures("root_logger")
def test_lines_for_people_and_for_machines(capfd: pytest.CaptureFixture[str]) -> None:
    log = logging.getLogger("tests.lines")
    for log_format in ("text", "json"):
        configure_logging("tracker", "info", log_format)
        log.debug("not shown")
        with traced("an-id-here"):
            log.warning("plan %s\nforged line", "late", extra=fields(tick=7))
    text, _, rest = capfd.readouterr().err.partition("{")
    (line,) = text.splitlines()
    assert line.endswith(r"WARNING tests.lines: plan late\nforged line tick=7")
    line = json.loads("{" + rest)
    assert line["message"] == "plan late\nforged line", "one line of JSON whatever the message holds"
    assert (line["service"], line["trace_id"], line["tick"], line["level"]) == ("tracker", "an-id-here", 7, "warning")


def test_an_exception_is_within_its_line() -> None:
    try:
        raise ValueError("why")
    except ValueError:
        record = logging.getLogger("x").makeRecord("x", logging.ERROR, "f", 1, "broke", (), sys.exc_info())
    line = json.loads(JsonLines("planner").format(record))
    assert "ValueError: why" in line["exception"]
