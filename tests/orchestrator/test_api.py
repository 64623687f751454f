"""The HTTP API over three real processes."""

from __future__ import annotations

import io
import json
from typing import Any

import httpx
import numpy as np
import pytest
from websockets.sync.client import connect

from orchestrator.client import Client, ServerProblem
from orchestrator.core.supervise import Stack

JSON = {"Content-Type": "application/json"}


def make(http: httpx.Client, **spec: Any) -> str:
    reply = http.post("/v1/characters", json={"pacing": "lockstep", **spec})
    assert reply.status_code == 201, reply.text
    return str(reply.json()["id"])


def test_a_command_over_http_moves_a_character_through_three_processes(http: httpx.Client) -> None:
    """`stand` turns any posture into its own: the plan is performed, planned and recorded by three processes."""
    character = make(http, seed=3)
    taken = http.post(f"/v1/characters/{character}/commands", json={"text": "a person is standing still."})
    assert taken.status_code == 202
    assert taken.json()["tick"] == 0
    state = http.post(f"/v1/characters/{character}/steps", json={"ticks": 40}).json()
    assert state["tick"] == 40
    assert not state["fallen"]
    assert state["plan_end_tick"] >= 60
    body = http.get(f"/v1/characters/{character}").json()
    assert body["plans"] == 2
    assert body["command"]["text"] == "a person is standing still."
    assert http.delete(f"/v1/characters/{character}").status_code == 204
    assert http.get(f"/v1/characters/{character}").status_code == 404


@pytest.mark.parametrize(
    ("body", "field", "allowed"),
    [
        ({"target": {"joint": "nose", "position_m": [1, 0, 0]}}, "target.joint", "left_wrist"),
        ('{"target": {"position_m": [1, NaN, 0]}}', "target.position_m.1", "finite"),
        ({"text": "x" * 10_000}, "text", "300"),
        ({"target": {"position_m": [50, 0, 0]}}, "target.position_m", "30 m"),
        ({"velocity_mps": [99, 0]}, "velocity_mps.0", "8"),
        ({"guidance": -1}, "guidance", ">= 0"),
    ],
)
def test_bad_commands_name_the_field_and_change_nothing(
    http: httpx.Client, body: Any, field: str, allowed: str
) -> None:  # fmt: skip
    character = make(http)
    before = http.get(f"/v1/characters/{character}").json()
    content = body if isinstance(body, str) else json.dumps(body)
    reply = http.post(f"/v1/characters/{character}/commands", content=content, headers=JSON)
    problem = reply.json()
    assert reply.status_code == 422
    assert reply.headers["content-type"] == "application/problem+json"
    assert problem["field"] == field
    assert allowed in problem["allowed"]
    assert http.get(f"/v1/characters/{character}").json() == before
    http.delete(f"/v1/characters/{character}")


@pytest.mark.parametrize(
    ("spec", "field"),
    [
        ({"tasks": [{"type": "reach", "time_limit_s": -1}]}, "tasks.0.reach.time_limit_s"),
        ({"tasks": []}, "tasks"),
        ({"tasks": [{"type": "fly"}]}, "tasks.0"),
        ({"tasks": [{"type": "halt"}], "time_limit_s": -3}, "time_limit_s"),
        ({"tasks": [{"type": "halt"}], "planner": "oracle"}, "planner"),
    ],
)
def test_bad_episodes_name_the_field_and_start_nothing(http: httpx.Client, spec: dict[str, Any], field: str) -> None:
    before = http.get("/v1/episodes").json()["total"]
    reply = http.post("/v1/episodes", json=spec)
    assert reply.status_code == 422
    assert reply.json()["field"] == field
    assert reply.json()["allowed"]
    assert http.get("/v1/episodes").json()["total"] == before


def test_an_episode_runs_is_followed_and_exported(stack: Stack, http: httpx.Client) -> None:
    with Client(stack.url) as client:
        tasks = [
            {"type": "halt", "settle_s": 0.5, "duration_s": 1.0},
            {"type": "text", "text": "jump", "duration_s": 1},
        ]
        run = client.episode(tasks, seed=5)
        events = list(run.events())
        assert [e.seq for e in events] == list(range(1, len(events) + 1))
        assert events[-1].type == "end"
        assert events[-1].data["status"] == "finished"
        episode = run.wait()
        assert [(r.type, r.success_strict) for r in episode.results] == [("halt", True), ("text", False)]
        assert episode.success is False
        assert episode.results[1].reason == "the motion does not show it"
        motion = run.motion()
        assert len(motion) == (episode.tick or 0) + 1
        assert motion.start_tick == 0
        assert run.export("bvh").startswith(b"HIERARCHY")
        assert run.export("csv").count(b"\n") == (episode.tick or 0) + 2
        assert run.export("glb").startswith(b"glTF")
        assert list(run.events()) == events
        page = http.get("/v1/episodes", params={"status": "finished", "limit": 1}).json()
        assert page["total"] >= 1
        assert page["items"][0]["id"] == run.id
        run.delete()
        with pytest.raises(ServerProblem, match="no episode"):
            run.info()


def test_an_episode_can_be_cancelled(stack: Stack) -> None:
    with Client(stack.url) as client:
        run = client.episode([{"type": "halt", "duration_s": 100}], pacing="realtime")
        run.cancel()
        assert [e.data["status"] for e in run.events() if e.type == "end"] == ["cancelled"]


def test_the_same_seed_gives_the_same_log_bit_for_bit(stack: Stack) -> None:
    with Client(stack.url) as client:
        logs = []
        for _ in range(2):
            run = client.episode([{"type": "reach", "time_limit_s": 2}], seed=11, tracker="pd")
            assert run.wait().status == "finished"
            with np.load(io.BytesIO(run.export("npz")), allow_pickle=False) as data:
                logs.append({name: data[name].tobytes() for name in data.files})
        assert logs[0] == logs[1]


def test_swaps_show_at_the_next_plan_and_an_unfit_one_changes_nothing(stack: Stack, http: httpx.Client) -> None:
    character = make(http, tracker=None)
    http.post(f"/v1/characters/{character}/steps", json={"ticks": 15})
    before = http.get("/v1/services").json()
    for body, field in (({"plugin": "oracle"}, "plugin"), ({}, "plugin"), ({"endpoint": "udp://x"}, "endpoint")):
        reply = http.put("/v1/services/planner", json=body)
        assert reply.status_code in (409, 422)
        assert reply.json()["field"] == field
    wrong = http.put("/v1/services/planner", json={"endpoint": stack.tracker.address})
    assert wrong.status_code == 409
    assert "tracker" in wrong.json()["detail"]
    assert http.get("/v1/services").json() == before
    assert http.put("/v1/services/tracker", json={"plugin": "pd"}).status_code == 200
    try:
        state = http.post(f"/v1/characters/{character}/steps", json={"ticks": 30}).json()
        assert state["tracker"] == "pd"
        assert state["tick"] == 45
        assert http.put("/v1/services/planner", json={"plugin": "stand"}).json()["plugin"] == "stand"
    finally:
        assert http.put("/v1/services/tracker", json={"plugin": "kinematic"}).status_code == 200
        http.delete(f"/v1/characters/{character}")


def test_realtime_is_streamed_paused_pushed_and_reset(stack: Stack, http: httpx.Client) -> None:
    character = make(http, pacing="realtime")
    with connect(stack.url.replace("http", "ws") + f"/v1/characters/{character}/stream") as socket:
        seen: dict[str, Any] = {}
        while not {"state", "event", "plan"} <= seen.keys():
            message = json.loads(socket.recv(timeout=30))
            seen[message["type"]] = message
        first = seen["state"]["tick"]
        while seen["state"]["tick"] < first + 10:
            message = json.loads(socket.recv(timeout=30))
            seen[message["type"]] = message
        assert len(seen["state"]["positions_m"]) == 22
        assert len(seen["plan"]["positions_m"][0]) == 22
    assert http.post(f"/v1/characters/{character}/steps", json={"ticks": 3}).status_code == 409
    push = {"body": "spine3", "impulse_ns": [0, 10, 0]}
    assert http.post(f"/v1/characters/{character}/impulses", json=push).status_code == 202
    bad = http.post(f"/v1/characters/{character}/impulses", json={**push, "body": "tail"})
    assert bad.status_code == 422
    assert bad.json()["field"] == "body"
    assert http.post(f"/v1/characters/{character}/reset").status_code == 200
    paused = http.post(f"/v1/characters/{character}/pause").json()["tick"]
    assert http.post(f"/v1/characters/{character}/resume").json()["tick"] - paused <= 2
    http.delete(f"/v1/characters/{character}")


def test_health_metrics_and_the_openapi_document(http: httpx.Client) -> None:
    assert http.get("/healthz").json()["status"] == "ok"
    assert http.get("/readyz").json()["services"] == {"planner": "ok", "tracker": "ok"}
    assert "motionloop_plans_total" in http.get("/metrics").text
    document = http.get("/openapi.json").json()
    assert "/v1/characters/{character_id}/commands" in document["paths"]
    examples = document["paths"]["/v1/episodes"]["post"]["requestBody"]["content"]["application/json"]["examples"]
    assert http.get("/v1/nothing").headers["content-type"] == "application/problem+json"
    reply = http.post("/v1/episodes", json=examples["tour"]["value"])
    assert reply.status_code == 201
    http.delete(f"/v1/episodes/{reply.json()['id']}")


def test_points_are_described_as_three_numbers(http: httpx.Client) -> None:
    schemas = http.get("/openapi.json").json()["components"]["schemas"]
    joints = http.get("/v1/skeleton").json()
    for model, field in (
        ("SkeletonBody", "offsets_m"),
        ("SkeletonBody", "rest_positions_m"),
        ("StateBody", "positions_m"),
    ):
        items = schemas[model]["properties"][field]["items"]
        assert (items["minItems"], items["maxItems"]) == (3, 3)
    assert all(len(point) == 3 for point in joints["offsets_m"])
