"""A page that makes its own name point at 127.0.0.1 (DNS rebinding) is not answered."""

from __future__ import annotations

import socket
from pathlib import Path

import httpx
import pytest
import yaml
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from orchestrator.api.hosts import host_of
from shared.errors import InvalidInputError
from shared.protocol.keys import main as make_keys
from shared.protocol.security import load_curve_keys

COMPOSE = Path(__file__).resolve().parents[2] / "docker-compose.yml"


@pytest.mark.parametrize(
    ("header", "host"),
    [
        ("127.0.0.1:8080", "127.0.0.1"), ("LocalHost:80", "localhost"), ("[::1]:8080", "::1"),
        ("evil.example.", "evil.example"), ("", ""), ("127.0.0.1.evil.example", "127.0.0.1.evil.example"), ("[", ""),
        ("user@127.0.0.1", "127.0.0.1"),
    ],
)  # fmt: skip
def test_the_name_in_a_host_header(header: str, host: str) -> None:
    assert host_of(header) == host


@pytest.mark.parametrize("path", ["/v1/characters", "/", "/healthz", "/openapi.json"])
def test_another_name_is_refused_whatever_is_asked(http: httpx.Client, path: str) -> None:
    for name in ("evil.example", "evil.example:8080", "127.0.0.1.evil.example", "localhost.evil.example", "0x7f.1"):
        reply = http.get(path, headers={"host": name})
        assert (reply.status_code, reply.headers["content-type"]) == (403, "application/problem+json")
        assert reply.json()["field"] == "host"


@pytest.mark.parametrize("name", ["localhost", "127.0.0.1:1234", "127.1.2.3", "[::1]:80", "LOCALHOST:80"])
def test_loopbacks_own_names_are_served(http: httpx.Client, name: str) -> None:
    assert http.get("/healthz", headers={"host": name}).status_code == 200


def test_a_refused_post_makes_nothing(http: httpx.Client) -> None:
    before = len(http.get("/v1/characters").json()["items"])
    assert http.post("/v1/characters", json={}, headers={"host": "evil.example"}).status_code == 403
    assert len(http.get("/v1/characters").json()["items"]) == before


def test_a_stream_is_refused_too(http: httpx.Client) -> None:
    made = http.post("/v1/characters", json={"pacing": "lockstep"}).json()["id"]
    port = http.base_url.port
    address = f"ws://evil.example:{port}/v1/characters/{made}/stream"
    line = socket.create_connection(("127.0.0.1", port or 0))
    with pytest.raises(InvalidStatus) as refused, connect(address, sock=line):
        raise AssertionError("a stream for another host was opened")
    assert refused.value.response.status_code == 403


def test_keys_apart_hold_one_secret_each(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    services, clients = tmp_path / "services", tmp_path / "clients"
    monkeypatch.setattr("sys.argv", ["keys", str(services), "--client", str(clients)])
    make_keys()
    server, client = load_curve_keys(services, "server"), load_curve_keys(clients, "client")
    assert server.peers == (client.public,)
    assert client.peers == (server.public,)
    for folder, side in ((services, "client"), (clients, "server")):
        with pytest.raises(InvalidInputError, match=side):
            load_curve_keys(folder, side)


def test_compose_gives_each_service_its_own_secrets_and_the_tracker_a_disk() -> None:
    services = yaml.safe_load(COMPOSE.read_text())["services"]
    keys = {name: [v for v in s.get("volumes", []) if "keys" in v] for name, s in services.items()}
    assert keys["planner"] == keys["tracker"] == ["server-keys:/keys:ro"]
    assert keys["orchestrator"] == ["client-keys:/keys:ro"]
    assert [name for name, s in services.items() if "MOTIONLOOP_TOKEN" in s.get("environment", {})] == ["orchestrator"]
    tracker = services["tracker"]
    spool = Path(tracker["environment"]["MOTIONLOOP_TRACKER_SPOOL_DIR"])
    assert "tracker-data:/data" in tracker["volumes"]
    assert spool.is_relative_to("/data")
    assert not any(spool.is_relative_to(folder) for folder in tracker["tmpfs"])
