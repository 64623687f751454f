"""Policies to be judged: a weights file, or the baseline that adds nothing to the reference."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt

from tracker_service.policy.learned import LearnedTracker
from tracker_service.simulation.humanoid import Humanoid
from tracker_service.training.env_settings import EnvSettings

F32 = npt.NDArray[np.float32]


def policy_of(human: Humanoid, weights: Path | None) -> tuple[EnvSettings, Callable[[F32], F32]]:
    """The environment's settings and the policy of a file, or of the `pd` baseline where `weights` is None."""
    hinges = len(human.hinges)

    def rest(observation: F32) -> F32:
        return np.zeros((len(observation), hinges), np.float32)

    if weights is None:
        return EnvSettings(), rest
    tracker = LearnedTracker(human.damping / human.stiffness, weights)
    return EnvSettings(heights=tracker.card.observation == "heights"), tracker.network
