"""Trackers by name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from shared.errors import InvalidInputError
from shared.plugins.interfaces import Tracker
from shared.plugins.registry import current_name
from tracker_service.policy.baselines import KinematicTracker, PdTracker
from tracker_service.policy.learned import WEIGHTS, LearnedTracker
from tracker_service.simulation.humanoid import Humanoid


def tracker_factories(human: Humanoid, weights: Path = WEIGHTS) -> dict[str, Callable[[], Tracker]]:
    """What can be made for a humanoid, by plug-in name."""
    ratio = human.damping / human.stiffness
    skeleton_id = human.skeleton.id
    return {
        "learned": lambda: LearnedTracker(ratio, weights),
        "pd": lambda: PdTracker(ratio, skeleton_id),
        "kinematic": lambda: KinematicTracker(skeleton_id),
    }


def make_tracker(name: str, human: Humanoid, weights: Path = WEIGHTS) -> Tracker:
    """Tracker by name; raises InvalidInputError listing the known ones."""
    factories, name = tracker_factories(human, weights), current_name(name)
    if name not in factories:
        raise InvalidInputError(f"unknown tracker {name!r}", field="tracker", allowed=", ".join(factories))
    return factories[name]()
