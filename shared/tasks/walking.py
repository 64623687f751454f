"""What tasks with several parts are put together from: walking somewhere and stepping back."""

from __future__ import annotations

from math import atan2

import numpy as np
import numpy.typing as npt

from shared.protocol.messages import TICK_HZ, HeadingTarget, JointTarget
from shared.tasks.approach import TRAJ
from shared.tasks.builtin import ReachTask
from shared.tasks.interface import BodyView, PlanGoal
from shared.tasks.specs import ReachSpec

Array = npt.NDArray[np.float64]
SAME_PLACE_M = 0.1
BACK_MPS = 0.6
BACK_HOLD_TICKS = 24
"""Planned anew every half second from the same stand, a step back is begun again and again and hardly made."""
BACK_TEXT = "a person steps backward."


class Walk:
    """The way to a place on the floor, gone as `reach` goes it; the place may move.

    Args:
        guidance: on the text, as in PlanGoal.
    """

    def __init__(self, guidance: float | None = None):
        self._guidance = guidance
        self._place: Array | None = None
        self._reach: ReachTask | None = None

    def goal(self, view: BodyView, place_xy_m: Array, plan_tick: int) -> PlanGoal:
        """What to ask for on the way to (2,) `place_xy_m`."""
        if self._place is None or float(np.linalg.norm(place_xy_m - self._place)) > SAME_PLACE_M:
            self._reach = None
        if self._reach is None:
            self._place = np.array(place_xy_m, dtype=np.float64)
            x, y = (float(v) for v in self._place)
            self._reach = ReachTask(ReachSpec(position_m=(x, y), guidance=self._guidance), 0)
            self._reach.start(view)
        return self._reach.goal(view, plan_tick)


def step_back(view: BodyView, from_xy_m: Array, distance_m: float, plan_tick: int, guidance: float | None) -> PlanGoal:
    """Go back until it is `distance_m` from a place, facing it."""
    away = view.pelvis_xy_m - from_xy_m
    now = float(np.linalg.norm(away))
    out = away / now if now > 1e-6 else -np.array([np.cos(view.heading_rad), np.sin(view.heading_rad)])
    x, y = (float(v) for v in from_xy_m + out * distance_m)
    arrival = plan_tick + round(min(max((distance_m - now) / BACK_MPS, 0.6), 2.0) * TICK_HZ)
    return PlanGoal(
        text=BACK_TEXT,
        targets=(JointTarget(joint=TRAJ, position_w_m=(x, y, 0.0), arrival_tick=arrival),),
        heading=HeadingTarget(heading_rad=atan2(-out[1], -out[0]), arrival_tick=arrival),
        guidance=guidance,
        hold_ticks=BACK_HOLD_TICKS,
    )
