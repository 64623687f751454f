"""Bodies that are knocked over lie, and what is asked of them from there is a way up."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from shared.data.corpus import FORMAT, ClipInfo, write_corpus
from shared.motion.ik import standing_clip
from shared.motion.kinematics import forward_kinematics
from shared.motion.rise import between
from shared.motion.rotations import matrix_from_rotvec
from tracker_service.policy.learned import WEIGHTS
from tracker_service.simulation.character_spec import character
from tracker_service.simulation.humanoid import humanoid
from tracker_service.training import falls as falls_module
from tracker_service.training.dataset import MotionInput
from tracker_service.training.falls import app, fall, falls, got_up, off_m, upright_references, ways_up
from tracker_service.training.policies import policy_of

HUMAN = humanoid(character("human"))
STANDING = standing_clip(2, 30.0).positions_w_m[0].astype(np.float64)


def lying_pose() -> np.ndarray:
    local = np.repeat(np.eye(3)[None], 22, 0)
    local[0] = matrix_from_rotvec(np.array([0.0, -np.pi / 2, 0.0]))
    return np.asarray(forward_kinematics(HUMAN.skeleton, np.array([[0.0, 0.0, 0.16]]), local[None])[0][0])


def test_knocked_over_bodies_lie_and_their_ways_lead_up() -> None:
    settings, policy = policy_of(HUMAN, WEIGHTS)
    upright = upright_references(HUMAN, None)
    qpos, lying = fall(HUMAN, upright, settings, policy, count=8, seed=3)
    assert len(qpos) == len(lying) >= 6
    assert (lying[:, 0, 2] < 0.45).all() and lying[..., 2].min() > -0.05
    again, _ = fall(HUMAN, upright, settings, policy, count=8, seed=3)
    np.testing.assert_array_equal(qpos, again)
    library = [between(lying[0], standing_clip(2, 30.0).positions_w_m[0], np.linspace(0, 1, 60), HUMAN.skeleton)]
    ways = ways_up(HUMAN, lying, library, 1.0)
    for way, pose in zip(ways, lying, strict=True):
        np.testing.assert_allclose(way.positions_w_m[0], pose, atol=1e-6)
        assert way.positions_w_m[-1, 0, 2] > 0.9
    result = falls(HUMAN, settings, policy, upright, library, count=8, seed=3)
    assert result["falls"] == len(lying)
    assert sum(row["n"] for row in result["by_facing"].values()) == len(lying)
    assert 0.0 <= result["got_up"] <= 1.0


def test_getting_up_needs_both_feet_half_a_second_and_to_stay_up() -> None:
    ticks = 210
    height = np.full((ticks, 4), 0.3)
    feet = np.ones((ticks, 4), dtype=bool)
    height[60:, 0] = 0.9  # up at two seconds, stays
    height[60:80, 1] = 0.9  # up, and down again within a second
    height[60:, 2] = 0.9
    feet[:, 2] = False  # never on both feet
    height[190:, 3] = 0.9  # too late
    assert got_up(height, feet).tolist() == [True, False, False, False]


def test_how_far_a_body_was_off_counts_from_the_tick_after_its_start() -> None:
    way = MotionInput("way", "get_up", 1.0, np.arange(4.0)[:, None, None] * np.ones((4, 22, 3)))
    did = way.positions_w_m[1:] + [0.3, 0.0, 0.4]
    held = np.concatenate([did, np.full((5, 22, 3), 99.0)])  # what comes after the way is over does not count
    assert off_m(did, way) == pytest.approx(0.5)
    assert off_m(held, way) == pytest.approx(0.5)


def test_what_is_recorded_for_rise_was_performed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A policy that cannot get up leaves no get-ups; one that is said to have done so leaves what it did."""
    way = between(lying_pose(), STANDING, np.linspace(0, 1, 60), HUMAN.skeleton).astype(np.float32)
    info = ClipInfo("way", "way", "made", "get_up", "get_up", ("get up",), "train", True, False, 0, 0, 1.0)
    write_corpus(tmp_path / "corpus", [(info, way)], {"format": FORMAT, "fps": 30.0})
    monkeypatch.setattr(falls_module, "upright_references", lambda human, corpus: upright_references(human, None))
    arguments = ["record", "--corpus", str(tmp_path / "corpus"), "--count", "6", "--keep", "2", "--seed", "3"]
    out = tmp_path / "rises"
    monkeypatch.setattr(falls_module, "stands", lambda human, did: np.zeros(did.shape[1], dtype=bool))
    assert CliRunner().invoke(app, [*arguments, "--out", str(out)]).exit_code == 0
    assert not list(out.glob("*.npz"))
    monkeypatch.setattr(falls_module, "stands", lambda human, did: np.ones(did.shape[1], dtype=bool))
    assert CliRunner().invoke(app, [*arguments, "--out", str(out)]).exit_code == 0
    kept = sorted(out.glob("*.npz"))
    assert kept
    assert all(sum(p.stem.startswith(side) for p in kept) <= 2 for side in ("up", "down", "side"))
    with np.load(kept[0]) as data:
        assert data["positions_w_m"].shape[1:] == (22, 3) and float(data["fps"]) == 30.0
        assert data["positions_w_m"][0, 0, 2] < 0.45
