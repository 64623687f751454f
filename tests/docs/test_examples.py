"""The examples pass the conformance suite as plug-ins of real services, and do what their pages say."""

from __future__ import annotations

import asyncio
import importlib.util
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import yaml

from orchestrator.client import Client
from orchestrator.core.episode_spec import EpisodeSpec
from orchestrator.core.scenes import Scenes
from shared.plugins.conformance import check_planner_endpoint, check_tracker_endpoint
from shared.plugins.interfaces import Planner, Tracker
from tests.docs.conftest import REPO, Served


def load(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_planner_passes_the_suite_and_glides_to_the_target(served: Served) -> None:
    assert isinstance(load(REPO / "examples" / "glide_planner" / "glide_planner.py").make_planner(), Planner)
    results = check_planner_endpoint(served.planner, "glide")
    assert [result for result in results if not result.passed] == []
    assert len(results) >= 8
    with Client(served.url) as client, client.character(pacing="lockstep", planner="glide") as character:
        character.say(target=(1.5, -0.5))
        there = character.step(150)
        assert np.linalg.norm(there.pelvis_w_m[:2] - [1.5, -0.5]) < 0.3


@pytest.mark.parametrize("name", ["drift", "sway"])
def test_planners_of_other_rates_and_lengths_pass_the_suite_and_drive_an_episode(served: Served, name: str) -> None:
    """30 fps, one prefix frame and half a second; 40 prefix frames: no settings, the loop takes them from the spec."""
    results = check_planner_endpoint(served.planner, name)
    assert [result for result in results if not result.passed] == []
    with Client(served.url) as client:
        there = {"type": "reach", "position_m": (1.5, -0.5)}
        episode = client.episode([there, {"type": "halt"}], planner=name, seed=3)
        info = episode.wait(timeout_s=120)
        assert info.success, info
        steps_m = np.linalg.norm(np.diff(episode.motion().positions_w_m, axis=0), axis=-1)
        assert steps_m.max() < 0.1, "plan joins plan without a jump"


def test_the_tracker_passes_the_suite_and_stands(served: Served) -> None:
    assert isinstance(load(REPO / "examples" / "ahead_tracker" / "ahead_tracker.py").make_tracker(), Tracker)
    results = check_tracker_endpoint(served.tracker, "ahead")
    assert [result for result in results if not result.passed] == []
    with Client(served.url) as client, client.character(pacing="lockstep", tracker="ahead") as character:
        state = character.step(30)
        assert (state.tracker, state.fallen) == ("ahead", False)


def test_the_square_is_walked(served: Served) -> None:
    """With `glide` and `kinematic` every corner is reached, so the line for a missed one must not show."""
    with Client(served.url) as client:
        client.swap("planner", "glide")
        try:
            done = subprocess.run(
                [sys.executable, str(REPO / "examples" / "steer.py"), served.url],
                env=served.environment, capture_output=True, text=True, timeout=170, check=False,
            )  # fmt: skip
        finally:
            client.swap("planner", "stand")
        assert len(client.characters) == 0
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("reached") == 4, done.stdout


def test_one_follows_the_other(served: Served, capsys: pytest.CaptureFixture[str]) -> None:
    asyncio.run(load(REPO / "examples" / "follow.py").main(served.url, seconds=1.0))
    assert [line.split(":")[0] for line in capsys.readouterr().out.splitlines()] == ["leader", "follower"]
    with Client(served.url) as client:
        assert len(client.characters) == 0


@pytest.mark.parametrize("file", sorted(path.name for path in (REPO / "examples").glob("*.yaml")))
def test_episodes_of_the_examples_are_valid_and_fit_their_scenes(file: str) -> None:
    spec = EpisodeSpec.model_validate(yaml.safe_load((REPO / "examples" / file).read_text()))
    scene = Scenes().chosen(spec.scene, spec.seed)
    for task in spec.tasks:
        task.check(scene)


@pytest.mark.parametrize("file", ["tour.yaml"])
def test_the_episode_files_are_accepted(served: Served, file: str) -> None:
    spec = yaml.safe_load((REPO / "examples" / file).read_text())
    with Client(served.url) as client:
        episode = client.episode(spec.pop("tasks"), **spec)
        assert episode.info().spec["name"] == "tour"
        episode.cancel()
        assert episode.wait(timeout_s=60).status in ("cancelled", "finished")
