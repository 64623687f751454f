"""The task `velocity`: go on at a speed in a direction."""

from __future__ import annotations

from math import atan2, cos, hypot, sin

import numpy as np
import numpy.typing as npt

from shared.protocol.messages import TICK_HZ, HeadingTarget, JointTarget
from shared.tasks.approach import TRAJ
from shared.tasks.interface import BodyView, PlanGoal, Status, Task, Trace, Verdict
from shared.tasks.specs import VelocitySpec

Array = npt.NDArray[np.float64]
AHEAD_S = 1.0
SLOW_MPS = 0.1


class VelocityTask(Task):
    """Neither paper nor release has it: `paper` is the strict rule, `code` the same whatever fell."""

    kind = "velocity"

    def __init__(self, spec: VelocitySpec):
        self._spec = spec
        self._velocity = np.zeros(2)

    @property
    def label(self) -> str:
        """E.g. `move at (1.0, 0.0) m/s`."""
        return f"move at ({self._velocity[0]:.1f}, {self._velocity[1]:.1f}) m/s"

    @property
    def time_limit_s(self) -> float:
        """Its duration and a margin of a second."""
        return self._spec.duration_s + 1.0

    def start(self, view: BodyView) -> None:
        """Fix the direction."""
        spec = self._spec
        if spec.velocity_mps is not None:
            self._velocity = np.array(spec.velocity_mps)
        elif spec.relative_mps is not None:
            (ahead, left), angle = spec.relative_mps, view.heading_rad
            self._velocity = np.array([ahead * cos(angle) - left * sin(angle), ahead * sin(angle) + left * cos(angle)])

    def goal(self, view: BodyView, plan_tick: int) -> PlanGoal:
        """A place a second ahead, and the velocity itself for planners that take one."""
        vx, vy = (float(v) for v in self._velocity)
        ahead = view.pelvis_xy_m + self._velocity * AHEAD_S
        arrival = plan_tick + round(AHEAD_S * TICK_HZ)
        heading = None
        if hypot(vx, vy) > SLOW_MPS:
            heading = HeadingTarget(heading_rad=atan2(vy, vx), arrival_tick=arrival)
        place = (float(ahead[0]), float(ahead[1]), 0.0)
        return PlanGoal(
            text=self._spec.text,
            targets=(JointTarget(joint=TRAJ, position_w_m=place, arrival_tick=arrival),),
            heading=heading,
            desired_velocity_w_mps=(vx, vy),
            guidance=self._spec.guidance,
        )

    def status(self, trace: Trace) -> Status:
        """Done when its time is over."""
        return "done" if trace.duration_s >= self._spec.duration_s else "running"

    def judge(self, trace: Trace) -> Verdict:
        """Mean velocity from the end of the settling time to the end of the duration."""
        begin, end = round(self._spec.settle_s * TICK_HZ), round(self._spec.duration_s * TICK_HZ)
        xy, fell = trace.pos_w_m[:end, 0, :2], bool(trace.fallen.any())
        if len(xy) < end:
            return Verdict(False, False, False, fell, trace.duration_s, {})
        mean = (xy[-1] - xy[begin]) * TICK_HZ / (len(xy) - 1 - begin)
        error = float(np.linalg.norm(mean - self._velocity))
        held = error <= self._spec.tolerance_mps
        measures = {"velocity_error_mps": error, "speed_mps": float(np.linalg.norm(mean))}
        return Verdict(held and not fell, held and not fell, held, fell, self._spec.duration_s, measures)
