"""The planner `rise`: a lying body gets a way up that begins where it lies; a standing one stands."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from planner_service.builtin.rise import RisePlanner
from planner_service.service.plugins import planner_registry
from planner_service.service.settings import PlannerSettings
from shared.errors import InvalidInputError
from shared.motion.ik import standing_clip
from shared.motion.kinematics import forward_kinematics
from shared.motion.rise import between
from shared.motion.rotations import matrix_from_rotvec
from shared.motion.skeleton import CANONICAL
from shared.plugins.conformance import LocalProbe, check_planner, require
from shared.protocol.messages import PlanRequest

STAND = standing_clip(2, 20.0).positions_w_m[0].astype(np.float64)


def lying() -> np.ndarray:
    local = np.repeat(np.eye(3)[None], len(CANONICAL), 0)
    local[0] = matrix_from_rotvec(np.array([0.0, -np.pi / 2, 0.0]))
    return np.asarray(forward_kinematics(CANONICAL, np.array([[2.0, 1.0, 0.16]]), local[None])[0][0])


@pytest.fixture
def library(tmp_path: Path) -> Path:
    way = between(lying() - np.array([2.0, 1.0, 0.0]), STAND, np.linspace(0.0, 1.0, 45), CANONICAL)
    np.savez(tmp_path / "supine.npz", positions_w_m=way.astype(np.float32), fps=30.0)
    return tmp_path


def request(pose: np.ndarray, horizon: int = 140) -> PlanRequest:
    still = np.zeros((1, 22, 3), "<f4")
    return PlanRequest(
        start_tick=30,
        prefix_positions_w_m=pose[None].astype("<f4"),
        prefix_rotations_6d=np.zeros((1, 22, 6), "<f4"),
        prefix_velocities_w_mps=still,
        horizon_frames=horizon,
    )


def test_a_lying_body_is_led_to_standing_where_it_lies(library: Path) -> None:
    plan = RisePlanner.load(library).plan([request(lying())])[0]
    positions = np.asarray(plan.positions_w_m)
    assert positions.shape == (140, 22, 3)
    assert np.linalg.norm(positions[0] - lying(), axis=-1).max() < 0.1
    assert positions[-1, 0, 2] > 0.9 and np.linalg.norm(positions[-1, 0, :2] - [2.0, 1.0]) < 1.0
    standing = RisePlanner.load(library).plan([request(STAND, 40)])[0]
    assert np.asarray(standing.positions_w_m)[:, 0, 2].min() > 0.85


def test_it_conforms_and_is_withdrawn_without_get_ups(library: Path, tmp_path: Path) -> None:
    require(check_planner(LocalProbe(RisePlanner.load(library))))
    with pytest.raises(InvalidInputError, match="no get-ups"):
        RisePlanner.load(tmp_path / "nothing")
    registry = planner_registry(PlannerSettings(rise_library=tmp_path / "nothing", plugins=("rise", "stand")))
    assert set(registry.load_all()) == {"stand"}
    assert "no get-ups" in registry.withdrawn()["rise"]
