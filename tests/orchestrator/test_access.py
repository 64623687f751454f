"""Who may do what, how much of it, and with which headers, over a real server."""

from __future__ import annotations

import asyncio
import base64
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import httpx
import pytest
from fastapi.testclient import TestClient
from starlette.types import Message, Receive, Scope, Send
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from orchestrator.api.access import needed_scope
from orchestrator.api.app import create_app
from orchestrator.api.limits import KEPT_CALLERS, Buckets, Limiter, Limits
from orchestrator.api.settings import OrchestratorSettings
from orchestrator.core.supervise import Stack
from shared.errors import InvalidInputError
from shared.settings import load_settings
from tests.orchestrator.support import light

ADMIN, COMMAND, WATCH = "admin-token-0123456789", "command-token-0123456789", "watch-token-0123456789"
TOKENS = {"token": ADMIN, "command_token": COMMAND, "watch_token": WATCH}
BODY = 4096


@pytest.fixture(scope="module")
def guarded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """A stack with a token for each scope and small limits."""
    arguments = (
        "--token", ADMIN, "--command-token", COMMAND, "--watch-token", WATCH, "--max-body-bytes", str(BODY),
        "--swap-endpoints", "tcp://127.0.0.1:9", "--max-streams", "2",
    )  # fmt: skip
    with Stack(replace(light(tmp_path_factory.mktemp("data")), orchestrator_args=arguments)) as stack:
        yield stack


def http(stack: Stack, token: str | None) -> httpx.Client:
    headers = {} if token is None else {"Authorization": f"Bearer {token}"}
    return httpx.Client(base_url=stack.url, headers=headers, timeout=60.0, trust_env=False)


@pytest.mark.parametrize(
    ("method", "path", "scope"),
    [
        ("GET", "/v1/services", "watch"), ("HEAD", "/v1/characters", "watch"), ("POST", "/v1/characters", "command"),
        ("DELETE", "/v1/episodes/x", "command"), ("PUT", "/v1/services/planner", "admin"),
        ("PUT", "/v1/characters/x/objects/y", "command"),
    ],
)  # fmt: skip
def test_what_needs_which_scope(method: str, path: str, scope: str) -> None:
    assert needed_scope(method, path) == scope


def test_each_token_does_what_its_scope_says_and_no_more(guarded: Stack) -> None:
    asked: list[tuple[str, str, dict[str, Any] | None]] = [
        ("GET", "/v1/characters", None),
        ("GET", "/metrics", None),
        ("POST", "/v1/characters", {"pacing": "lockstep"}),
        ("PUT", "/v1/services/planner", {"plugin": "stand"}),
    ]
    wanted = {
        None: [401, 401, 401, 401],
        "wrong-token-0123456789": [401, 401, 401, 401],
        WATCH: [200, 200, 403, 403],
        COMMAND: [200, 200, 201, 403],
        ADMIN: [200, 200, 201, 200],
    }
    for token, codes in wanted.items():
        with http(guarded, token) as client:
            replies = [client.request(method, path, json=body) for method, path, body in asked]
            assert [reply.status_code for reply in replies] == codes, token
            for reply in replies:
                if reply.status_code == 403:
                    assert reply.json()["code"] == "forbidden"
                    assert 'error="insufficient_scope"' in reply.headers["www-authenticate"]
    with http(guarded, ADMIN) as client:
        for character in client.get("/v1/characters").json()["items"]:
            assert client.delete(f"/v1/characters/{character['id']}").status_code == 204


def test_a_stream_is_for_those_who_may_watch_and_there_are_only_so_many(guarded: Stack) -> None:
    with http(guarded, COMMAND) as client:
        character = client.post("/v1/characters", json={"pacing": "lockstep"}).json()["id"]
    url = f"{guarded.url.replace('http', 'ws')}/v1/characters/{character}/stream"
    with pytest.raises(InvalidStatus):
        connect(url, proxy=None)
    text = base64.urlsafe_b64encode(WATCH.encode()).decode().rstrip("=")
    offered: Any = ["motionloop", f"bearer.{text}"]
    with connect(url, subprotocols=offered, proxy=None) as one, connect(url, subprotocols=offered, proxy=None) as two:
        for socket in (one, two):
            assert socket.recv(timeout=30)
        with pytest.raises((InvalidStatus, ConnectionClosed)):
            connect(url, subprotocols=offered, proxy=None)
    with connect(url, subprotocols=offered, proxy=None) as again:
        assert again.recv(timeout=30)


def test_a_page_of_another_site_changes_nothing(guarded: Stack) -> None:
    with http(guarded, ADMIN) as client:
        for origin, code in (("http://evil.example", 403), ("null", 403), (guarded.url, 404)):
            sent = {"origin": origin}
            path = "/v1/characters/00000000-0000-0000-0000-000000000000/reset"
            assert client.post(path, headers=sent).status_code == code
            reply = client.get("/v1/characters", headers=sent)
            assert reply.status_code == 200
            assert "access-control-allow-origin" not in reply.headers


def test_a_swap_goes_only_where_the_list_says(guarded: Stack) -> None:
    with http(guarded, ADMIN) as client:
        refused = client.put("/v1/services/planner", json={"endpoint": "tcp://127.0.0.1:10"})
        assert (refused.status_code, refused.json()["code"]) == (403, "forbidden")
        listed = client.put("/v1/services/planner", json={"endpoint": "tcp://127.0.0.1:9"})
        assert listed.json()["code"] == "unavailable", "it was tried, nobody is there"
        own = client.put("/v1/services/planner", json={"endpoint": guarded.planner.address})
        assert own.status_code == 200


def test_where_a_server_may_swap_to() -> None:
    def may(**given: Any) -> bool:
        return load_settings(OrchestratorSettings, {"token": ADMIN, **given}).may_swap_to("tcp://10.0.0.7:5601")

    assert may()
    assert not may(host="0.0.0.0")
    assert may(host="0.0.0.0", swap_endpoints="tcp://10.0.0.7:5601,tcp://10.0.0.8:5601")
    assert not may(swap_endpoints="tcp://10.0.0.8:5601")
    assert may(host="0.0.0.0", planner="tcp://10.0.0.7:5601")


def test_a_large_body_is_refused_with_and_without_its_length(guarded: Stack) -> None:
    with http(guarded, ADMIN) as client:
        before = len(client.get("/v1/characters").json()["items"])
        padded = b'{"pacing": "lockstep"' + b" " * BODY + b"}"
        json = {"content-type": "application/json"}
        for content in (padded, iter([padded[:100], padded[100:]])):
            refused = client.post("/v1/characters", content=content, headers=json)
            assert (refused.status_code, refused.json()["code"]) == (413, "too_large")
        assert len(client.get("/v1/characters").json()["items"]) == before


def test_too_many_requests_are_told_when_to_come_again_and_probes_are_answered() -> None:
    app = create_app(load_settings(OrchestratorSettings, {"max_rate_per_s": "0.01"}))
    client = TestClient(app, base_url="http://localhost")  # not entered: no services are needed
    assert client.get("/v1/nothing").status_code == 404
    reply = client.get("/v1/nothing")
    assert (reply.status_code, reply.json()["code"], reply.json()["retryable"]) == (429, "rate_limited", True)
    assert 1 <= int(reply.headers["retry-after"]) <= 100
    assert reply.headers["x-trace-id"]
    assert client.get("/healthz").status_code == 200


def test_a_bucket_by_hand() -> None:
    now_s = 0.0
    buckets = Buckets(10.0, lambda: now_s)
    assert [buckets.wait_s("a") for _ in range(20)] == [0.0] * 20
    assert buckets.wait_s("a") == pytest.approx(0.1)
    assert buckets.wait_s("b") == 0.0
    now_s = 0.05
    assert buckets.wait_s("a") == pytest.approx(0.05)
    now_s = 0.1
    assert buckets.wait_s("a") == 0.0
    assert buckets.wait_s("a") == pytest.approx(0.1)
    for number in range(KEPT_CALLERS):
        buckets.wait_s(str(number))
    assert buckets.wait_s("a") == 0.0, "forgotten, the oldest begins anew"


def test_more_requests_at_once_than_allowed_are_refused_and_end_no_other() -> None:
    async def play() -> list[int]:
        gate = asyncio.Event()
        codes: list[int] = []

        async def slow(scope: Scope, receive: Receive, send: Send) -> None:
            await gate.wait()
            await send({"type": "http.response.start", "status": 200, "headers": []})
            await send({"type": "http.response.body", "body": b""})

        limiter = Limiter(slow, Limits(BODY, 1e6, 2, 1))

        async def ask() -> None:
            async def receive() -> Message:
                return {"type": "http.request", "body": b"", "more_body": False}

            async def send(message: Message) -> None:
                if message["type"] == "http.response.start":
                    codes.append(message["status"])
                    if message["status"] == 503:
                        assert dict(message["headers"])[b"retry-after"] == b"1"

            await limiter({"type": "http", "path": "/v1/x", "headers": [], "client": ("c", 1)}, receive, send)

        tasks = [asyncio.create_task(ask()) for _ in range(3)]
        await asyncio.sleep(0)
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        gate.set()
        await asyncio.gather(*tasks)
        await ask()
        return codes

    assert asyncio.run(play()) == [503, 200, 200, 200]


def test_headers_of_the_api_the_page_and_the_interactive_documentation(guarded: Stack) -> None:
    with http(guarded, WATCH) as client:
        api, missing, page, docs = (client.get(path) for path in ("/v1/tasks", "/v1/no", "/", "/docs"))
    for reply in (api, missing, page, docs):
        assert reply.headers["x-content-type-options"] == "nosniff"
        assert reply.headers["x-frame-options"] == "DENY"
    for reply in (api, missing):
        assert reply.headers["content-security-policy"] == "default-src 'none'; frame-ancestors 'none'"
        assert reply.headers["cache-control"] == "no-store"
    assert "script-src 'self'" in page.headers["content-security-policy"]
    assert page.headers["cache-control"] == "no-cache"
    assert "content-security-policy" not in docs.headers


def test_a_bug_says_nothing_of_the_inside() -> None:
    app = create_app(load_settings(OrchestratorSettings))

    @app.get("/bug")
    async def bug() -> None:
        raise RuntimeError("a secret of the inside")

    reply = TestClient(app, base_url="http://localhost", raise_server_exceptions=False).get("/bug")
    assert (reply.status_code, reply.json()["code"]) == (500, "internal")
    assert "secret" not in reply.text


@pytest.mark.parametrize(
    ("given", "words"),
    [({"watch_token": "short"}, "16 characters"), ({"watch_token": ADMIN}, "a token of its own")],
)
def test_tokens_that_guard_nothing_are_refused(given: dict[str, str], words: str) -> None:
    with pytest.raises(InvalidInputError) as caught:
        load_settings(OrchestratorSettings, {"token": ADMIN, **given})
    assert words in caught.value.message
