"""Does a stretch of motion show what its clip's text says?

A clip called "jump" holds standing before and after the jump. A window of it that only stands would teach that "jump"
may mean standing, so such windows lose their text, and joins enter only where the deed is still to come.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from planner_service.training.windows import Features
from shared.motion.features import JOINT_POSITIONS, ROOT_VELOCITY, YAW_RATE
from shared.motion.metrics import FOOT_JOINTS
from shared.motion.skeleton import CANONICAL

Bools = npt.NDArray[np.bool_]

LEAST_FRAMES = {"jump": 2, "kick": 2, "wave": 10, "turn": 8, "walk": 18, "run": 18}
"""Behaviours that are deeds, and the frames of a plan (0.05 s each) that must show them."""
AIRBORNE_M = 0.05
HIGH_FOOT_M = 0.35
TURNING_RADPS = 0.35
GOING_MPS = {"walk": 0.45, "run": 1.2}
"""A clip of walking begins with standing, and a join from standing finds just that: so "walk" came to mean waiting."""


def frames_showing(features: Features, behaviour: str) -> Bools:
    """(...) whether each frame of features (..., 263) shows the behaviour; always True where it is not a deed.

    jump: both feet off the floor; kick: a foot high; wave: a wrist above its shoulder; turn: the body turns; walk and
    run: the root gets on.
    """
    heights = features[..., JOINT_POSITIONS].reshape(features.shape[:-1] + (21, 3))[..., 2]
    feet = CANONICAL.indices(*FOOT_JOINTS)
    lift = heights[..., feet - 1] - CANONICAL.rest_positions_m[feet, 2]
    if behaviour == "jump":
        return np.asarray(lift.min(-1) > AIRBORNE_M)
    if behaviour == "kick":
        return np.asarray(lift.max(-1) > HIGH_FOOT_M)
    if behaviour == "wave":
        wrists = heights[..., CANONICAL.indices("left_wrist", "right_wrist") - 1]
        shoulders = heights[..., CANONICAL.indices("left_shoulder", "right_shoulder") - 1]
        return np.asarray((wrists > shoulders).any(-1))
    if behaviour in GOING_MPS:
        return np.asarray(np.linalg.norm(features[..., ROOT_VELOCITY], axis=-1) > GOING_MPS[behaviour])
    if behaviour == "turn":
        return np.asarray(np.abs(features[..., YAW_RATE][..., 0]) > TURNING_RADPS)
    return np.ones(features.shape[:-1], np.bool_)


def plans_showing(plans: Features, behaviours: list[str]) -> Bools:
    """(B,) whether each plan (B, N, 263) shows the behaviour that its text is about."""
    return np.array(
        [
            frames_showing(plan, behaviour).sum() >= LEAST_FRAMES.get(behaviour, 0)
            for plan, behaviour in zip(plans, behaviours, strict=True)
        ]
    )


def deed_ahead(features: Features, behaviour: str, frames: int) -> Bools:
    """(T,) for each frame of a clip (T, 263) whether the `frames` frames from it on show the behaviour."""
    shown = np.concatenate([[0], np.cumsum(frames_showing(features, behaviour))])
    end = np.minimum(np.arange(len(features)) + frames, len(features))
    return np.asarray(shown[end] - shown[:-1] >= LEAST_FRAMES.get(behaviour, 0))
