"""A tracker of our own: servo targets from the reference two ticks ahead. Explained in docs/writing_a_tracker.md."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from shared.motion.skeleton import CANONICAL
from shared.plugins.interfaces import FloatArray, Tracker, TrackerObservation, TrackerSpec

AHEAD_TICKS = 2


class AheadTracker:
    """Servos trail a moving target; aiming a little ahead makes up for that. It keeps no state."""

    spec = TrackerSpec(name="ahead", version="1", skeleton=CANONICAL.id, fps=30.0, drives="pd_targets")

    def reset(self, character_ids: Sequence[str]) -> None:
        """A tracker that keeps something for a character forgets it here."""

    def act(self, character_ids: Sequence[str], observations: Sequence[TrackerObservation]) -> FloatArray:
        """(B, H) hinge angles in radians for the servos during the next tick, in the order given."""
        targets = []
        for seen in observations:
            row = min(AHEAD_TICKS, len(seen.ref_hinge_rad) - 1)  # row 0 is the next tick
            targets.append(seen.ref_hinge_rad[row])
        return np.stack(targets)


def make_tracker() -> Tracker:
    """What the entry point names: called without arguments, once."""
    return AheadTracker()
