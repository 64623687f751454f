"""The bound on reference motion that training relies on, over a corpus built here (DESIGN 9: before any PPO runs)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from shared.data.build import build
from shared.data.corpus import Corpus
from shared.motion.ik import clip_from_positions
from shared.motion.io.bvh import write_bvh
from shared.motion.limbs import solve_arm
from shared.motion.skeleton import CANONICAL
from tests.data.samples import stepping
from tracker_service.simulation.character_spec import HUMAN
from tracker_service.simulation.humanoid import humanoid
from tracker_service.training.dataset import MotionInput, ReferenceSet, prepare
from tracker_service.training.main import motions

HUMANOID = humanoid(HUMAN)
MAX_STEP_RAD = 1.0
"""Largest change of a reference hinge angle in one tick (30 rad/s) for everyday motion. Arms swung in full circles
(HDM05's rotateArms) pass the shoulder's pole and exceed it; tests/data/test_corpus.py bounds their rotations."""


def largest_steps_rad(references: ReferenceSet) -> np.ndarray:
    """(C,) largest change of any hinge angle from one tick to the next, by clip."""
    return np.array(
        [
            np.abs(np.diff(references.qpos[start : start + length, 7:], axis=0)).max()
            for start, length in zip(references.start, references.length, strict=True)
        ]
    )


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Corpus:
    """Walks of three speeds, and what the build makes of them: bent paths, turns, waves, idling, jumps."""
    folder: Path = tmp_path_factory.mktemp("corpus")
    source = folder / "mocap" / "deepmimic"
    source.mkdir(parents=True)
    for i in range(3):
        write_bvh(source / f"walk{i}.bvh", clip_from_positions(stepping(150, 0.8 + 0.3 * i), 30.0, rebuild=True))
    build(folder / "mocap", folder / "built", seed=2, amount=0.3)
    return Corpus.load(folder / "built")


def test_reference_angles_change_by_a_bounded_amount_per_tick(corpus: Corpus) -> None:
    clips = motions(corpus, "train") + motions(corpus, "heldout")
    assert {clip.behaviour for clip in clips} >= {"walk", "turn"}
    steps = largest_steps_rad(prepare(HUMANOID, clips))
    worst = int(steps.argmax())
    assert steps[worst] <= MAX_STEP_RAD, f"{clips[worst].name}: {steps[worst]:.2f} rad in a tick"


def test_the_bound_notices_a_limb_that_snaps() -> None:
    """An arm that is elsewhere from one frame to the next must not pass."""
    arm = stepping(60)
    wrist = arm[30:, CANONICAL.index("left_wrist")] + np.array([0.3, 0.2, 0.7])
    arm[30:] = solve_arm(arm[30:], "left", wrist)
    steps = largest_steps_rad(prepare(HUMANOID, [MotionInput("snap", "wave", 1.0, arm)]))
    assert steps[0] > MAX_STEP_RAD
