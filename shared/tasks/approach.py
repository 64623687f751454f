"""The one way from a place to be at to what a planner is asked for: whoever names the place, a task or a command."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from shared.protocol.messages import TICK_HZ, HeadingTarget, JointTarget
from shared.tasks.interface import BodyView, PlanGoal
from shared.tasks.specs import ReachTuning

Array = npt.NDArray[np.float64]

TRAJ = "traj"
MOST_S = 2.0
"""No step takes longer: it is about what a plan covers."""

TURN_RADPS = 1.6
"""Natural speed of turning on the spot."""


def turn_on_the_spot(view: BodyView, plan_tick: int, bearing_rad: float, guidance: float | None) -> PlanGoal:
    """Turn by `bearing_rad` (left positive) where it stands."""
    x, y = (float(v) for v in view.pelvis_xy_m)
    arrival = plan_tick + round(max(abs(bearing_rad) / TURN_RADPS, 0.5) * TICK_HZ)
    side = "left" if bearing_rad > 0 else "right"
    return PlanGoal(
        text=f"a person turns to the {side}.",
        targets=(JointTarget(joint=TRAJ, position_w_m=(x, y, 0.0), arrival_tick=arrival),),
        heading=HeadingTarget(heading_rad=view.heading_rad + bearing_rad, arrival_tick=arrival),
        guidance=guidance,
    )


def stepped_target(from_m: Array, goal_m: Array, most_m: float) -> Array:
    """The goal, or the point `most_m` toward it where it is farther (REFERENCE 3); (2,) or (3,)."""
    away = goal_m - from_m
    distance = float(np.linalg.norm(away))
    return goal_m if distance <= most_m else from_m + away * (most_m / distance)


class Pace:
    """How fast the pelvis goes over the floor, from one look at the body to the next."""

    def __init__(self) -> None:
        self._last: BodyView | None = None

    def forget(self) -> None:
        """The next look is the first."""
        self._last = None

    def mps(self, view: BodyView) -> float | None:
        """Mean speed since the last look; None at the first, or at the same tick."""
        before, self._last = self._last, view
        if before is None or view.tick <= before.tick:
            return None
        way_m = float(np.linalg.norm(view.pelvis_xy_m - before.pelvis_xy_m))
        return way_m * TICK_HZ / (view.tick - before.tick)


class Approach:
    """A joint on its way to a place, in steps that a plan can make, at a natural speed.

    The arrival tick of the last step is fixed when the place comes within one step, and counts down from plan to plan,
    so that the joint does arrive.

    Args:
        joint: a skeleton joint, or `traj` for the root on the floor.
        tuning: step_m, speed_mps and least_arrival_s count, of a body of canonical size.
    """

    def __init__(self, joint: str, tuning: ReachTuning):
        self._joint = joint
        self._tuning = tuning
        self._arrival_tick: int | None = None

    def forget(self) -> None:
        """The next target starts a new way."""
        self._arrival_tick = None

    def target(self, here_m: Array, goal_m: Array, plan_tick: int, body_scale: float = 1.0) -> JointTarget:
        """Where the joint should be next, and when.

        Args:
            here_m, goal_m: (2,) on the floor for `traj`, else (3,), world.
            plan_tick: where the plan starts.
            body_scale: size of the body against the canonical one; steps and speed grow with it.
        """
        tuning = self._tuning
        step_m, speed_mps = tuning.step_m * body_scale, tuning.speed_mps * body_scale
        distance = float(np.linalg.norm(goal_m - here_m))
        point = stepped_target(here_m, goal_m, step_m)
        seconds = float(np.linalg.norm(point - here_m)) / speed_mps
        arrival = plan_tick + round(min(max(seconds, tuning.least_arrival_s), MOST_S) * TICK_HZ)
        if distance > step_m:
            self._arrival_tick = None
        else:
            if self._arrival_tick is None or self._arrival_tick < plan_tick + tuning.least_arrival_s * TICK_HZ:
                self._arrival_tick = arrival
            arrival = self._arrival_tick
        place = (float(point[0]), float(point[1]), float(point[2]) if len(point) > 2 else 0.0)
        return JointTarget(joint=self._joint, position_w_m=place, arrival_tick=arrival)
