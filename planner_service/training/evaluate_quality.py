"""Physical plausibility of many clips at once, in the fields of `eval planner`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from shared.motion.metrics import (
    floating_mm,
    foot_contacts,
    jerk_mps3,
    limb_speed_mps,
    penetration_mm,
    skating_mm_per_frame,
    sole_points,
)
from shared.protocol.rates import PLANNER_FPS as FPS

Array = npt.NDArray[np.float64]

SLACK_MM = 5.0
"""Skating, penetration and floating below this are good whatever the recordings have ..."""
SLACK = 1.3
"""... and so are those within this factor of the recordings'."""


def quality(clips: Sequence[Array]) -> dict[str, float]:
    """Means over clips (T, 22, 3) at 20 fps of what `shared.motion.metrics` measures."""
    return {
        "penetration_mm": float(np.mean([penetration_mm(c) for c in clips])),
        "floating_mm": float(np.mean([floating_mm(c) for c in clips])),
        "skating_mm": float(np.mean([skating_mm_per_frame(c) for c in clips])),
        "skating_contact_mm": float(np.mean([contact_slide_mm(c) for c in clips])),
        "jerk": float(np.mean([jerk_mps3(c, FPS) for c in clips])),
        "limb_speed_mps": float(np.mean([limb_speed_mps(c, FPS) for c in clips])),
    }


def within_bounds(made: dict[str, float], truth: dict[str, float]) -> dict[str, bool]:
    """Whether penetration, floating and skating are at most the larger of SLACK times the recordings' and SLACK_MM."""
    names = ("penetration_mm", "floating_mm", "skating_mm")
    return {name: made[name] <= max(SLACK * truth[name], SLACK_MM) for name in names}


def contact_slide_mm(positions_w_m: Array) -> float:
    """Mean horizontal way a frame of sole points in contact (low and slower than 0.4 m/s) in both frames."""
    touching = foot_contacts(positions_w_m, FPS)
    both = touching[1:] & touching[:-1]
    way = np.linalg.norm(np.diff(sole_points(positions_w_m)[..., :2], axis=0), axis=-1)
    return float(way[both].mean() * 1e3) if both.any() else 0.0
