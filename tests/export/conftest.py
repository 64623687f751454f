"""One recorded episode of each kind, and its files, shared by the tests of this folder."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from orchestrator.client import Client, Motion
from orchestrator.core.supervise import Stack
from tests.orchestrator.support import light
from tests.planner_service.motion import write_library

TASKS = [
    {"type": "reach", "relative_m": [2.0, 0.8], "time_limit_s": 2.5},
    {"type": "text", "text": "a person waves with the right hand", "duration_s": 1.5},
]


@pytest.fixture(scope="session")
def stack(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """Planner `clip`, and the trackers without weights."""
    library = write_library(tmp_path_factory.mktemp("library"))
    with Stack(light(tmp_path_factory.mktemp("data"), library)) as running:
        yield running


@pytest.fixture(scope="session", params=["kinematic", "pd"])
def folder(stack: Stack, request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`motion.npz`, `.bvh`, `.glb` and `.csv` of a walk with a turn and a wave; under `pd` it stumbles."""
    out = tmp_path_factory.mktemp(request.param)
    with Client(stack.url) as client:
        episode = client.episode(TASKS, planner="clip", tracker=request.param, seed=3)
        episode.wait(timeout_s=170)
        for suffix in ("npz", "bvh", "glb", "csv"):
            episode.save(out / f"motion.{suffix}")
        episode.save(out / "centimetres.bvh", unit="cm")
    return out


@pytest.fixture
def motion(folder: Path) -> Motion:
    """The recording itself."""
    return Motion.from_npz(folder / "motion.npz")
