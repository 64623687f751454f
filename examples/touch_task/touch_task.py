"""A task of one's own: `touch`, a hand to a point that it can reach from where it stands."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from shared.motion.skeleton import CANONICAL
from shared.protocol.messages import TICK_HZ, JointTarget
from shared.tasks.approach import Approach
from shared.tasks.factory import TaskKind
from shared.tasks.interface import BodyView, PlanGoal, Status, Task, Trace, Verdict
from shared.tasks.specs import BaseTaskSpec, Coordinate, ReachTuning, TimeLimit


class TouchSpec(BaseTaskSpec):
    """Touch a point, in the world, with a hand: its wrist within `radius_m` of it."""

    type: Literal["touch"] = "touch"
    hand: Literal["left", "right"] = "right"
    position_m: tuple[Coordinate, Coordinate, Coordinate] = (0.4, -0.2, 1.2)
    radius_m: Annotated[float, Field(gt=0, le=1)] = 0.1
    time_limit_s: TimeLimit = 6.0


class TouchTask(Task):
    """The wrist to the point, in steps that a plan can make."""

    kind = "touch"

    def __init__(self, spec: TouchSpec):
        self._spec = spec
        self._joint = f"{spec.hand}_wrist"
        self._approach = Approach(self._joint, ReachTuning(speed_mps=0.8))

    @property
    def label(self) -> str:
        """E.g. `touch with the right hand`."""
        return f"touch with the {self._spec.hand} hand"

    @property
    def time_limit_s(self) -> float:
        """From the spec."""
        return self._spec.time_limit_s

    @property
    def upright(self) -> bool:
        """Who lies has not touched it as asked."""
        return True

    def start(self, view: BodyView) -> None:
        """The point is known already."""
        self._approach.forget()

    def goal(self, view: BodyView, plan_tick: int) -> PlanGoal:
        """The wrist's target; its arrival tick counts down."""
        here = view.pos_w_m[CANONICAL.index(self._joint)]
        target: JointTarget = self._approach.target(here, np.array(self._spec.position_m), plan_tick, view.scale)
        return PlanGoal(text=f"a person reaches out with the {self._spec.hand} hand.", targets=(target,))

    def status(self, trace: Trace) -> Status:
        """Done at the first touch."""
        return "done" if len(trace) and bool((self._distances_m(trace) <= self._spec.radius_m).any()) else "running"

    def judge(self, trace: Trace) -> Verdict:
        """One rule for all three: touched, and strict without a fall."""
        away, fell = self._distances_m(trace), bool(trace.fallen.any())
        near = away <= self._spec.radius_m
        touched = bool(near.any())
        seconds = float(np.argmax(near)) / TICK_HZ if touched else trace.duration_s
        measures = {"least_distance_m": float(away.min())} if len(away) else {}
        return Verdict(touched and not fell, touched, touched, fell, seconds, measures)

    def _distances_m(self, trace: Trace) -> np.ndarray:
        wrist = trace.pos_w_m[:, CANONICAL.index(self._joint)]
        return np.linalg.norm(wrist - np.array(self._spec.position_m), axis=-1)


KIND = TaskKind(TouchSpec, lambda spec, seed: TouchTask(spec))
