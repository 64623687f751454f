"""Numbers of all three services against what was done; `motionloop top`; the dashboard asks for what there is."""

from __future__ import annotations

import json
import os
import re
import socket
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import httpx
import pytest
from prometheus_client import CollectorRegistry, Counter
from prometheus_client.parser import text_string_to_metric_families

from orchestrator.client import Client
from orchestrator.core.supervise import Stack
from shared.errors import InvalidInputError
from shared.protocol.messages import StateFrame, Step
from shared.protocol.transport import ServiceClient
from shared.settings import ServiceSettings, load_settings
from shared.telemetry import MetricsEndpoint
from tests.orchestrator.support import light, play

DEPLOY = Path(__file__).resolve().parents[2] / "deploy"


@pytest.fixture(scope="module")
def ports() -> tuple[int, int]:
    """Two ports that are free now."""
    with socket.socket() as one, socket.socket() as two:
        one.bind(("127.0.0.1", 0))
        two.bind(("127.0.0.1", 0))
        return one.getsockname()[1], two.getsockname()[1]


@pytest.fixture(scope="module")
def watched(tmp_path_factory: pytest.TempPathFactory, ports: tuple[int, int]) -> Iterator[Stack]:
    options = light(tmp_path_factory.mktemp("data"))
    planner = (*options.planner_args, "--metrics-port", str(ports[0]))
    with Stack(replace(options, planner_args=planner, tracker_args=("--metrics-port", str(ports[1])))) as stack:
        yield stack


def numbers(url: str) -> dict[str, float]:
    """Every sample as `name{label="value"}` -> value."""
    reply = httpx.get(url, trust_env=False)
    assert reply.status_code == 200
    found = {}
    for family in text_string_to_metric_families(reply.text):
        for sample in family.samples:
            labels = ",".join(f'{key}="{value}"' for key, value in sorted(sample.labels.items()))
            found[f"{sample.name}{{{labels}}}" if labels else sample.name] = sample.value
    return found


def all_numbers(stack: Stack, ports: tuple[int, int]) -> dict[str, float]:
    urls = (f"{stack.url}/metrics", *(f"http://127.0.0.1:{port}/metrics" for port in ports))
    return {name: value for url in urls for name, value in numbers(url).items()}


def test_the_numbers_are_those_of_what_was_done(watched: Stack, ports: tuple[int, int]) -> None:
    before = all_numbers(watched, ports)
    with Client(watched.url) as client, client.character(pacing="lockstep") as character:
        character.say("a person stands.")
        character.step(60)
        plans = character.info().plans
        assert plans > 0
        now = all_numbers(watched, ports)
    of_planner = '{planner="stand"}'
    rise = {name: value - before.get(name, 0.0) for name, value in now.items()}
    assert rise["motionloop_tracker_ticks_total"] == 60
    assert rise["motionloop_tracker_tick_seconds_count"] == 60
    assert rise["motionloop_commands_total"] == 1
    assert rise['motionloop_plans_total{accepted="true"}'] == plans
    assert rise['motionloop_planner_requests_total{outcome="plan",planner="stand"}'] == plans
    assert rise[f"motionloop_planner_plan_seconds_count{of_planner}"] == plans
    assert rise[f"motionloop_planner_queue_seconds_count{of_planner}"] == plans
    assert rise[f"motionloop_planner_batch_size_sum{of_planner}"] == plans
    assert rise["motionloop_plan_seconds_count"] == plans
    assert rise["motionloop_tracker_falls_total"] == rise["motionloop_falls_total"] == 0
    assert now["motionloop_characters"] == now["motionloop_tracker_characters"] == 1


def test_an_episode_counts_when_it_ends_and_its_character_stays_counted(watched: Stack, ports: tuple[int, int]) -> None:
    before = all_numbers(watched, ports)
    with httpx.Client(base_url=watched.url, timeout=60.0) as http:
        play(http, {"tasks": [{"type": "halt", "settle_s": 0.5, "duration_s": 0.5}], "pacing": "lockstep"})
    now = all_numbers(watched, ports)
    assert now['motionloop_episodes_total{status="finished"}'] == 1
    assert now["motionloop_episodes_running"] == 0
    assert now['motionloop_plans_total{accepted="true"}'] > before['motionloop_plans_total{accepted="true"}']


def test_a_plan_that_runs_out_is_one_stall(watched: Stack, ports: tuple[int, int]) -> None:
    before = numbers(f"http://127.0.0.1:{ports[1]}/metrics")["motionloop_tracker_stalls_total"]
    with Client(watched.url) as client, client.character(pacing="lockstep") as character:
        end = character.step(1).plan_end_tick
        assert end > 1
        with ServiceClient(watched.tracker.address, "tracker") as tracker:  # past the loop: no further plan comes
            for ticks in (end, 5, 5):
                tracker.ask(Step(ticks=ticks), StateFrame, character.id)
    assert numbers(f"http://127.0.0.1:{ports[1]}/metrics")["motionloop_tracker_stalls_total"] == before + 1


def test_a_taken_metrics_port_is_told_by_name(ports: tuple[int, int], watched: Stack) -> None:
    for module in ("planner_service", "tracker_service"):
        command = [sys.executable, "-m", module, "--endpoint", "tcp://127.0.0.1:0", "--metrics-port", str(ports[0])]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
        assert done.returncode == 2, done.stderr
        assert f"metrics_port: port {ports[0]} cannot be used" in done.stderr


def test_numbers_beyond_this_machine_take_a_token() -> None:
    registry = CollectorRegistry()
    Counter("things", "counted", registry=registry).inc()
    endpoint = MetricsEndpoint(registry)
    endpoint.start(0, token="sixteen-characters")
    try:
        assert endpoint.url is not None
        for header in ({}, {"authorization": "Bearer sixteen"}, {"authorization": "Basic sixteen-characters"}):
            refused = httpx.get(endpoint.url, headers=header)
            assert (refused.status_code, "things" in refused.text) == (401, False)
        told = httpx.get(endpoint.url, headers={"authorization": "Bearer sixteen-characters"})
        assert told.status_code == 200 and "things_total 1.0" in told.text
    finally:
        endpoint.close()
    here: dict[str, object] = {"endpoint": "tcp://127.0.0.1:0", "metrics_port": 0, "metrics_host": "0.0.0.0"}
    for token, words in (({}, "set metrics_token"), ({"metrics_token": "short"}, "at least 16")):
        with pytest.raises(InvalidInputError, match=words):
            load_settings(ServiceSettings, {**here, **token})
    assert load_settings(ServiceSettings, {**here, "metrics_token": "m" * 16}).metrics_host == "0.0.0.0"


def test_top_shows_services_characters_and_episodes(watched: Stack, tmp_path: Path) -> None:
    file = tmp_path / "new" / "top.jsonl"
    with Client(watched.url) as client, client.character(pacing="realtime") as character:
        character.say("a person stands.")
        episode = client.episode([{"type": "halt", "duration_s": 60}], pacing="realtime")
        command = [sys.executable, "-m", "motionloop", "top", "--every", "0.5", "--seconds", "2", "--url", watched.url]
        done = subprocess.run(
            [*command, "--json", str(file)], capture_output=True, text=True, timeout=60, check=True,
            env={**os.environ, "COLUMNS": "200"},
        )  # fmt: skip
        episode.cancel()
    for words in ("planner", "tracker", "stand", "kinematic", character.id[:8], episode.id[:8], "0 of 1", "missed"):
        assert words in done.stderr
    looks = [json.loads(line) for line in file.read_text().splitlines()]
    assert len(looks) >= 2
    assert looks[-1]["services"]["tracker"]["detail"]["ticks"] > looks[0]["services"]["tracker"]["detail"]["ticks"]
    assert looks[-1]["services"]["planner"]["detail"]["stand.plan_ms"] > 0
    assert [c["id"] for c in looks[-1]["characters"]] == [character.id]
    assert "positions_m" not in looks[-1]["characters"][0]["state"]


def test_the_dashboard_asks_only_for_numbers_that_there_are(watched: Stack, ports: tuple[int, int]) -> None:
    dashboard = json.loads((DEPLOY / "grafana" / "motionloop.json").read_text())
    with httpx.Client(base_url=watched.url, timeout=60.0) as http:  # labelled counters have no sample before the first
        play(http, {"tasks": [{"type": "halt", "settle_s": 0.5, "duration_s": 0.5}], "pacing": "lockstep"})
    served = {name.partition("{")[0] for name in all_numbers(watched, ports)}
    asked = {
        name
        for panel in dashboard["panels"]
        for target in panel["targets"]
        for name in re.findall(r"motionloop_\w+", target["expr"])
    }
    assert len(asked) >= 15
    assert asked <= served, asked - served
