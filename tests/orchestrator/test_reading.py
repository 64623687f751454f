"""The reply to a command says how it was taken; what is noteworthy of it is an event too."""

from __future__ import annotations

from typing import Any

import httpx
import numpy as np
import pytest

from orchestrator.core.command import Command
from orchestrator.core.reading import ignored_conditions, unreachable_joints
from orchestrator.core.steps import STEP_S, SteppedGoal
from shared.motion.ik import standing_clip
from shared.motion.skeleton import CANONICAL
from shared.plugins.interfaces import PlannerSpec
from shared.tasks.builtin import TextTask
from shared.tasks.interface import BodyView, Trace
from shared.tasks.specs import TextSpec
from shared.text.wording import STAND_TEXT

VIEW = BodyView(0, np.asarray(standing_clip(1, 30.0).positions_w_m[0], dtype=np.float64))


def planner(*conditions: str, joints: tuple[str, ...] | None = None) -> PlannerSpec:
    return PlannerSpec(
        name="mine", version="1", skeleton=CANONICAL.id, fps=20, prefix_frames=20, plan_frames=40,
        conditions=conditions, target_joints=joints,
    )  # fmt: skip


@pytest.fixture
def character(http: httpx.Client) -> str:
    reply = http.post("/v1/characters", json={"pacing": "lockstep"})
    return f"/v1/characters/{reply.json()['id']}"


def told(http: httpx.Client, character: str, command: dict[str, Any]) -> dict[str, Any]:
    reply = http.post(f"{character}/commands", json=command)
    assert reply.status_code == 202, reply.text
    return dict(reply.json())


def test_a_negated_text_is_answered_with_what_was_understood(http: httpx.Client, character: str) -> None:
    reply = told(http, character, {"text": "a person walks without running"})
    assert (reply["understood"], reply["dropped"]) == ("a person walks", ["without running"])
    assert told(http, character, {"text": "a person does not walk"})["understood"] == STAND_TEXT
    assert http.get(character).json()["command"]["text"] == "a person does not walk"
    plain = told(http, character, {"text": "walk forward"})
    assert (plain["understood"], plain["steps"], plain["dropped"]) == ("walk forward", ["walk forward"], [])


def test_steps_are_said_and_done_in_order(http: httpx.Client, character: str) -> None:
    assert told(http, character, {"text": "walk, then wave"})["steps"] == ["walk", "wave"]
    goal = SteppedGoal(Command(text="walk, then wave"), issued_tick=30)
    ticks = [30, round(30 + STEP_S * 30) - 1, round(30 + STEP_S * 30), 10_000]
    assert [goal(VIEW, tick).text for tick in ticks] == ["walk", "walk", "wave", "wave"]


def test_what_the_planner_cannot_do_comes_back(http: httpx.Client, character: str) -> None:
    """The planner `stand` honours nothing at all."""
    reply = told(
        http, character,
        {
            "text": "walk", "target": {"joint": "left_elbow", "position_m": [0.5, 0.2, 1.2]}, "heading_rad": 0.0,
            "avoid": [{"position_m": [1, 0, 1], "radius_m": 0.3}],
        },
    )  # fmt: skip
    assert {"text", "target", "heading", "obstacles"} <= set(reply["ignored_conditions"])
    assert reply["nearest"] is None  # words count for nothing here


def test_ignored_and_unreachable_by_what_the_planner_declares() -> None:
    target = {"joint": "left_elbow", "position_m": (0.5, 0.2, 1.2)}
    elbow = Command.model_validate({"target": target, "velocity_mps": (1.0, 0.0)})
    assert unreachable_joints(elbow, planner("target", joints=("left_wrist", "traj"))) == ["left_elbow"]
    assert unreachable_joints(elbow, planner("target")) == []
    assert ignored_conditions(elbow, planner("target")) == ["velocity"]
    steered = Command(velocity_mps=(1.0, 0.0))
    assert ignored_conditions(steered, planner("target")) == []  # it becomes a target ahead
    assert ignored_conditions(steered, planner("text")) == ["velocity"]


def test_a_task_leaves_out_what_its_text_denies() -> None:
    task = TextTask(TextSpec(text="a person does not walk", duration_s=4))
    task.start(VIEW)
    assert task.goal(VIEW, 0).text == STAND_TEXT
    still = np.repeat(VIEW.pos_w_m[None], 150, axis=0)
    assert task.judge(Trace(0, still, np.zeros(150, bool))).strict
    walking = still + np.linspace(0, 3, 150)[:, None, None] * np.array([1.0, 0, 0])
    assert not task.judge(Trace(0, walking, np.zeros(150, bool))).strict


def test_a_task_of_two_steps_judges_each() -> None:
    task = TextTask(TextSpec(text="walk, then stand still", duration_s=8))
    task.start(BodyView(30, VIEW.pos_w_m))
    assert [task.goal(VIEW, tick).text for tick in (30, 149, 150, 269)] == [
        "walk",
        "walk",
        "stand still",
        "stand still",
    ]
    way = np.concatenate([np.linspace(0, 3, 120), np.full(150, 3.0)])
    motion = VIEW.pos_w_m[None] + way[:, None, None] * np.array([1.0, 0, 0])
    assert task.judge(Trace(31, motion, np.zeros(270, bool))).strict
    assert not task.judge(Trace(31, motion[::-1], np.zeros(270, bool))).strict
