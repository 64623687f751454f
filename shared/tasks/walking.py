"""What tasks with several parts are put together from: walking somewhere and stepping to a place near by."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from shared.protocol.messages import TICK_HZ, HeadingTarget, JointTarget
from shared.tasks.approach import TRAJ
from shared.tasks.builtin import ReachTask
from shared.tasks.interface import BodyView, PlanGoal
from shared.tasks.specs import ReachSpec

Array = npt.NDArray[np.float64]
SAME_PLACE_M = 0.1
STILL_MPS = 0.3
"""Slower than this a body has come to rest: turned, or struck, out of a walk it goes on for half a metre."""
STEP_MPS, LEAST_STEP_S = 0.6, 1.0
STEP_HOLD_TICKS = 30
"""Planned anew every half second from the same stand, a step is begun again and again and hardly made."""
FORWARD_TEXT, BACK_TEXT = "a person steps forward.", "a person steps backward."


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


def step_to(view: BodyView, place_xy_m: Array, facing_rad: float, plan_tick: int, guidance: float | None) -> PlanGoal:
    """One step, ahead or back, to (2,) a place on the floor near by, facing a way."""
    away = place_xy_m - view.pelvis_xy_m
    ahead = float(away @ np.array([np.cos(facing_rad), np.sin(facing_rad)])) >= 0
    seconds = float(np.linalg.norm(away)) / (STEP_MPS * view.scale)
    arrival = plan_tick + round(min(max(seconds, LEAST_STEP_S), 2.0) * TICK_HZ)
    x, y = (float(v) for v in place_xy_m)
    return PlanGoal(
        text=FORWARD_TEXT if ahead else BACK_TEXT,
        targets=(JointTarget(joint=TRAJ, position_w_m=(x, y, 0.0), arrival_tick=arrival),),
        heading=HeadingTarget(heading_rad=facing_rad, arrival_tick=arrival),
        guidance=guidance,
        hold_ticks=STEP_HOLD_TICKS,
    )
