"""Trackers without weights: `pd` drives the servos with the reference, `kinematic` shows the reference itself."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from shared.plugins.interfaces import TrackerObservation, TrackerSpec
from shared.protocol.messages import SERVO_TARGETS, TICK_HZ
from tracker_service.policy.observations import feedforward_targets

Array = npt.NDArray[np.floating]

VERSION = "1"


class PdTracker:
    """Reference pose as servo target, led by the servos' lag: the baseline every policy must beat.

    Args:
        damping_ratio_s: (H,) damping over stiffness of the character's servos.
        skeleton_id: it drives.
    """

    def __init__(self, damping_ratio_s: Array, skeleton_id: str):
        self._ratio = damping_ratio_s
        self.spec = TrackerSpec(
            name="pd", version=VERSION, skeleton=skeleton_id, fps=TICK_HZ, characters=None,
            action_spaces=(SERVO_TARGETS,),
        )  # fmt: skip

    def reset(self, character_ids: Sequence[str]) -> None:
        """It keeps no state."""

    def act(self, character_ids: Sequence[str], observations: Sequence[TrackerObservation]) -> Array:
        """(B, H) targets in radians."""
        ref = np.stack([o.ref_hinge_rad[:2] for o in observations])
        return feedforward_targets(ref[:, 0], ref[:, 1], TICK_HZ, self._ratio)


class KinematicTracker:
    """No physics: the character is where the reference is."""

    def __init__(self, skeleton_id: str):
        self.spec = TrackerSpec(
            name="kinematic", version=VERSION, skeleton=skeleton_id, fps=TICK_HZ, drives="pose", characters=None
        )

    def reset(self, character_ids: Sequence[str]) -> None:
        """It keeps no state."""

    def act(self, character_ids: Sequence[str], observations: Sequence[TrackerObservation]) -> Array:
        """(B, H) the reference's hinge angles at the next tick (shown, not driven)."""
        return np.stack([o.ref_hinge_rad[0] for o in observations])
