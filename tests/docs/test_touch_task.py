"""The example of a task outside our tree, as an installed package."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import httpx

from tests.docs.conftest import Served

ABOUT = """
import numpy as np
from pydantic import TypeAdapter
from shared.motion.ik import standing_clip
from shared.motion.skeleton import CANONICAL
from shared.tasks.factory import KINDS, TaskSpec, make_task
from shared.tasks.interface import BodyView, Trace

assert "touch" in KINDS
stand = standing_clip(1, 30).positions_w_m[0]
wrist = stand[CANONICAL.index("left_wrist")]
spec = TypeAdapter(TaskSpec).validate_python(
    {"type": "touch", "hand": "left", "position_m": list(wrist + [0.3, 0.0, 0.2])})
task = make_task(spec, 0)
task.start(BodyView(0, stand))
(target,) = task.goal(BodyView(0, stand), 0).targets
assert target.joint == "left_wrist" and target.arrival_tick > 0
positions = np.repeat(stand[None], 30, axis=0)
still = Trace(1, positions, np.zeros(30, bool))
assert task.status(still) == "running" and not task.judge(still).strict
positions = positions.copy()
positions[12:, CANONICAL.index("left_wrist")] += [0.3, 0.0, 0.2]
moved = Trace(1, positions, np.zeros(30, bool))
assert task.status(moved) == "done"
verdict = task.judge(moved)
assert verdict.strict and verdict.seconds == 12 / 30
assert not task.judge(Trace(1, positions, np.ones(30, bool))).strict
"""


def test_an_installed_task_is_found_made_and_judged(served: Served, tmp_path: Path) -> None:
    site = served.environment["PYTHONPATH"]
    done = subprocess.run(
        [sys.executable, "-c", ABOUT], env=served.environment, cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"{site}\n{done.stderr}"


def test_an_episode_takes_it_like_any_other(served: Served) -> None:
    kinds = {item["type"] for item in httpx.get(f"{served.url}/v1/tasks").json()["items"]}
    assert "touch" in kinds
    task = {"type": "touch", "position_m": [0.5, -0.2, 1.3], "time_limit_s": 1}
    made = httpx.post(f"{served.url}/v1/episodes", json={"tasks": [task]})
    assert made.status_code == 201, made.text
    path = f"{served.url}/v1/episodes/{made.json()['id']}"
    httpx.get(f"{path}/events", timeout=60)
    (result,) = httpx.get(path).json()["results"]
    assert (result["type"], result["success_strict"], result["reason"]) == ("touch", False, "timed out")
    assert 0.1 < result["measures"]["least_distance_m"] < 2
    wrong = httpx.post(f"{served.url}/v1/episodes", json={"tasks": [{"type": "touch", "hand": "third"}]})
    assert wrong.status_code == 422
