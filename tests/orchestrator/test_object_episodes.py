"""Episodes of the tasks with objects over the real services: they end, with the reason and what was recorded."""

from __future__ import annotations

from typing import Any

import httpx
import pytest

from orchestrator.core.events import captions_of
from orchestrator.rest import Event
from tests.orchestrator.support import play

SIT_UP: list[dict[str, Any]] = [{"type": "sit", "time_limit_s": 3}, {"type": "get_up", "time_limit_s": 2}]


@pytest.mark.parametrize(
    ("scene", "tasks"),
    [
        ("bag", [{"type": "strike", "limb": "left_foot", "time_limit_s": 3}]),
        ("sofa", SIT_UP),
        ("flat", [{"type": "get_up", "from": "floor", "time_limit_s": 2}]),
        ("flat", [{"type": "velocity", "relative_mps": [1, 0], "duration_s": 2}]),
    ],
)
@pytest.mark.parametrize(("planner", "tracker"), [("stand", "kinematic"), ("clip", "pd")])
def test_a_task_ends_with_its_reason(
    http: httpx.Client, scene: str, tasks: list[dict[str, Any]], planner: str, tracker: str
) -> None:
    """Who only stands, or walks anywhere, strikes nothing: an honest failure, in time."""
    spec = {"scene": scene, "tasks": tasks, "seed": 2, "planner": planner, "tracker": tracker}
    episode, recording = play(http, spec)
    assert episode["status"] == "finished", episode["reason"]
    assert [result["type"] for result in episode["results"]] == [task["type"] for task in tasks]
    for result in episode["results"]:
        assert not result["success_strict"]
        assert result["reason"] in ("timed out", "fell", "the motion does not show it", "task_failed")
        if result["type"] != "velocity" and not result["fell"]:
            assert result["stop_tick"] - result["start_tick"] >= 60
    measures = episode["results"][0]["measures"]
    if scene == "bag" and not episode["results"][0]["fell"] and planner == "stand":
        assert measures["tilt_deg"] < 5
        assert measures["limb_first"] == 0
    assert recording


def test_a_missed_strike_is_tried_again_as_often_as_it_may(http: httpx.Client) -> None:
    spec = {"scene": "bag", "tasks": [{"type": "strike", "time_limit_s": 2, "retries": 2}, {"type": "halt"}]}
    reply = http.post("/v1/episodes", json=spec)
    assert reply.status_code == 201, reply.text
    path = f"/v1/episodes/{reply.json()['id']}"
    lines = http.get(f"{path}/events").text.splitlines()
    events = [Event.model_validate_json(line.removeprefix("data:")) for line in lines if line.startswith("data:")]
    missed = [event.tick for event in events if event.type == "task_missed"]
    assert len(missed) == 2
    results = http.get(path).json()["results"]
    captions = captions_of(events)  # a video says what each attempt is, not only the last
    assert [text for _, text in captions] == ["strike with the right hand"] * 3 + ["stand still"]
    assert captions[0][0] < missed[0] <= captions[1][0] < missed[1] <= captions[2][0] == results[0]["start_tick"]
    assert [result["type"] for result in results] == ["strike", "halt"]
    assert results[0]["reason"] == "timed out"
    assert results[1]["success_strict"]


def test_a_sequence_over_one_room_in_random_order(http: httpx.Client) -> None:
    tasks = [{"type": "strike", "time_limit_s": 1}, {"type": "sit", "time_limit_s": 1}, {"type": "halt"}]
    orders = set()
    for seed in range(4):
        episode, _ = play(http, {"scene": "room", "tasks": tasks, "order": "random", "seed": seed})
        assert episode["status"] == "finished"
        orders.add(tuple(result["index"] for result in episode["results"]))
        assert sorted(result["index"] for result in episode["results"]) == [0, 1, 2]
    assert len(orders) > 1


def test_a_scene_without_what_the_task_is_about_is_refused_at_once(http: httpx.Client) -> None:
    reply = http.post("/v1/episodes", json={"scene": "bag", "tasks": [{"type": "sit"}]})
    assert reply.status_code == 422, reply.text
    assert "seat_centre" in reply.text
    assert "bag_centre" in reply.text


def test_the_catalogue_shows_every_kind_with_its_fields(http: httpx.Client) -> None:
    items = {item["type"]: item for item in http.get("/v1/tasks").json()["items"]}
    assert {"reach", "strike", "sit", "get_up", "halt", "text", "velocity"} <= set(items)
    assert items["strike"]["parameters"]["properties"]["limb"]["enum"] == [
        "left_hand", "right_hand", "left_foot", "right_foot",
    ]  # fmt: skip
    assert "from" in items["get_up"]["parameters"]["properties"]
