"""What the orchestrator refuses to start with, and who it lets in."""

from __future__ import annotations

import subprocess
import sys

import pytest
from fastapi.testclient import TestClient

from orchestrator.api.app import create_app
from orchestrator.api.settings import OrchestratorSettings
from shared.errors import InvalidInputError
from shared.settings import load_settings


@pytest.mark.parametrize(
    ("environment", "words"),
    [
        ({"MOTIONLOOP_HOST": "0.0.0.0"}, "MOTIONLOOP_TOKEN"),
        ({"MOTIONLOOP_HOST": "example.org"}, "MOTIONLOOP_TOKEN"),
        ({"MOTIONLOOP_HOST": "0.0.0.0", "MOTIONLOOP_TOKEN": "short"}, "16 characters"),
        ({"MOTIONLOOP_PORT": "99999"}, "65535"),
    ],
)
def test_insecure_or_wrong_settings_are_refused(
    monkeypatch: pytest.MonkeyPatch, environment: dict[str, str], words: str
) -> None:
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    with pytest.raises(InvalidInputError) as caught:
        load_settings(OrchestratorSettings)
    assert words in f"{caught.value.message} {caught.value.allowed}"


def test_loopback_needs_no_token_and_others_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MOTIONLOOP_TOKEN", "")  # as compose files set what is not given: it counts as not set
    assert load_settings(OrchestratorSettings).token is None
    monkeypatch.setenv("MOTIONLOOP_HOST", "0.0.0.0")
    monkeypatch.setenv("MOTIONLOOP_TOKEN", "0123456789abcdef")
    assert load_settings(OrchestratorSettings).host == "0.0.0.0"


def test_the_process_says_why_it_does_not_start() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "orchestrator", "--host", "0.0.0.0"], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 2
    assert "MOTIONLOOP_TOKEN" in done.stderr


def test_without_the_token_nothing_but_health_answers() -> None:
    settings = load_settings(OrchestratorSettings, {"token": "0123456789abcdef"})
    client = TestClient(create_app(settings))  # not entered: no services are needed to be refused
    for headers in ({}, {"Authorization": "Bearer 0123456789abcdeX"}):
        reply = client.get("/v1/services", headers=headers)
        assert reply.status_code == 401
        assert reply.headers["www-authenticate"] == "Bearer"
        assert reply.json()["code"] == "unauthorized"
    assert client.get("/healthz").status_code == 200
    allowed = client.get("/v1/services", headers={"Authorization": "Bearer 0123456789abcdef"})
    assert allowed.status_code == 503
