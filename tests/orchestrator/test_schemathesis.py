"""Requests made up from the OpenAPI document, sound and unsound: no error of the server, nothing the document lacks.

The examples are the same in every run. `SCHEMATHESIS_EXAMPLES=200` looks further.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace

import httpx
import pytest
import schemathesis
from hypothesis import HealthCheck, Phase, given, settings
from schemathesis import Case, GenerationMode
from schemathesis.checks import not_a_server_error
from schemathesis.core.failures import FailureGroup
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    response_headers_conformance,
    response_schema_conformance,
    status_code_conformance,
)

from orchestrator.core.supervise import Stack
from tests.orchestrator.support import light

EXAMPLES = int(os.environ.get("SCHEMATHESIS_EXAMPLES", "6"))
CHECKS = [
    not_a_server_error, status_code_conformance, content_type_conformance, response_headers_conformance,
    response_schema_conformance,
]  # fmt: skip
pytestmark = pytest.mark.timeout(600)


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """A stack that swaps nowhere: made-up addresses take a time-out each."""
    arguments = ("--max-running", "6", "--swap-endpoints", "ipc:///nowhere")
    with Stack(replace(light(tmp_path_factory.mktemp("data")), orchestrator_args=arguments)) as stack:
        yield stack


@pytest.fixture(scope="module")
def known(served: Stack) -> dict[str, str]:
    """Ids that there are: without them every request of a character or an episode would be a 404."""
    with httpx.Client(base_url=served.url, timeout=60.0) as http:
        character = http.post("/v1/characters", json={"pacing": "lockstep"}).json()["id"]
        tasks = [{"type": "halt", "settle_s": 0.5, "duration_s": 0.5}]
        episode = http.post("/v1/episodes", json={"tasks": tasks}).json()["id"]
        http.get(f"/v1/episodes/{episode}/events")
    return {"character_id": character, "episode_id": episode}


@pytest.fixture(scope="module")
def api(served: Stack) -> schemathesis.BaseSchema:
    """The document, less what renders a video."""
    return schemathesis.openapi.from_url(f"{served.url}/openapi.json").exclude(path_regex=r"video\.mp4$")


@pytest.mark.parametrize("mode", list(GenerationMode), ids=lambda mode: mode.value)
def test_the_server_keeps_to_its_document(
    api: schemathesis.BaseSchema, known: dict[str, str], mode: GenerationMode
) -> None:
    asked, broken = set(), []
    for result in api.get_all_operations():
        operation = result.ok()
        if mode is GenerationMode.NEGATIVE and not (operation.body or operation.query or operation.path_parameters):
            continue

        @settings(
            max_examples=EXAMPLES, derandomize=True, deadline=None, database=None, phases=(Phase.generate,),
            suppress_health_check=list(HealthCheck),
        )  # fmt: skip
        @given(case=operation.as_strategy(generation_mode=mode))
        def ask(case: Case) -> None:
            if case.method != "DELETE":
                there = {name: value for name, value in known.items() if f"{{{name}}}" in case.path}
                case.path_parameters = {**(case.path_parameters or {}), **there}
            asked.add(case.operation.label)
            case.call_and_validate(checks=CHECKS, timeout=60.0)

        try:
            ask()
        except FailureGroup as failures:
            broken += [f"{operation.label}: {failure}" for failure in failures.exceptions]
    assert not broken, "\n\n".join(broken)
    assert len(asked) >= (30 if mode is GenerationMode.POSITIVE else 20)
