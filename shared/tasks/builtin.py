"""The built-in tasks `reach`, `halt` and `text`."""

from __future__ import annotations

from math import atan2, cos, pi, sin

import numpy as np
import numpy.typing as npt

from shared.errors import ConflictError
from shared.motion.rotations import wrap_angle
from shared.protocol.messages import TICK_HZ, HeadingTarget, JointTarget
from shared.tasks import rules
from shared.tasks.approach import TRAJ, Approach, Pace, turn_on_the_spot
from shared.tasks.interface import BodyView, PlanGoal, Status, Task, Trace, Verdict
from shared.tasks.obey import kind_of, obeyed
from shared.tasks.specs import HaltSpec, ReachSpec, ReachTuning, TextSpec
from shared.text.wording import STAND_TEXT, understand

Array = npt.NDArray[np.float64]

SLOW_MPS = 0.25
"""Slower than this, a body that was told to halt has come to rest."""
HOLD_TICKS = 30
"""How far ahead a standing body's spot is set as target."""


class ReachTask(Task):
    """Walk (run, sneak, ...) until the pelvis is over a point on the floor, and stop there."""

    kind = "reach"

    def __init__(self, spec: ReachSpec, seed: int):
        self._spec = spec
        self._tuning: ReachTuning = spec.paced
        self._rng = np.random.default_rng(seed)
        self._goal: Array | None = None
        self._approach = Approach(TRAJ, spec.paced)
        self._near_since: int | None = None
        self._corrections = 0
        self._turning = False
        self._stand_heading_rad: float | None = None

    @property
    def label(self) -> str:
        """E.g. `reach (1.2, -0.5)`."""
        where = "a random point" if self._goal is None else f"({self._goal[0]:.2f}, {self._goal[1]:.2f})"
        return f"reach {where}"

    @property
    def time_limit_s(self) -> float:
        """From the spec."""
        return self._spec.time_limit_s

    @property
    def goal_xy_m(self) -> Array:
        """(2,) the point; raises ConflictError before `start` has fixed it."""
        if self._goal is None:
            raise ConflictError("the task was not started, its goal is not known yet")
        return self._goal

    def start(self, view: BodyView) -> None:
        """Fix the goal: the given point, one relative to the body, or a random one 1-3 m away in any direction."""
        spec = self._spec
        if spec.position_m is not None:
            self._goal = np.array(spec.position_m[:2])
        else:
            if spec.relative_m is not None:
                ahead, left = spec.relative_m
                distance, bearing = float(np.hypot(ahead, left)), atan2(left, ahead)
            else:
                distance, bearing = self._rng.uniform(*spec.random_distance_m), self._rng.uniform(-pi, pi)
            angle = view.heading_rad + bearing
            self._goal = view.pelvis_xy_m + distance * np.array([cos(angle), sin(angle)])
        self._approach.forget()
        self._near_since, self._turning, self._corrections = None, False, 0

    def goal(self, view: BodyView, plan_tick: int) -> PlanGoal:
        """Target at most `step_m` ahead, reached at a natural speed; a turn first, standing once it is close."""
        tuning, goal = self._tuning, self.goal_xy_m
        away = goal - view.pelvis_xy_m
        distance = float(np.linalg.norm(away))
        near = self._is_near(distance, view.tick)
        bearing = float(wrap_angle(atan2(away[1], away[0]) - view.heading_rad))
        self._turning = abs(bearing) > (tuning.turn_to_rad if self._turning else tuning.turn_from_rad)
        if self._turning and not near:
            self._approach.forget()
            return turn_on_the_spot(view, plan_tick, bearing, self._spec.guidance)
        target = self._approach.target(view.pelvis_xy_m, goal, plan_tick, view.scale)
        arrival = target.arrival_tick
        if near:
            if self._stand_heading_rad is None:
                self._stand_heading_rad = view.heading_rad
            facing = HeadingTarget(heading_rad=self._stand_heading_rad, arrival_tick=arrival)
            return PlanGoal(text=STAND_TEXT, targets=(target,), heading=facing, guidance=self._spec.guidance)
        self._stand_heading_rad = None
        heading = None
        if distance > tuning.heading_from_m:
            heading = HeadingTarget(heading_rad=atan2(away[1], away[0]), arrival_tick=arrival)
        return PlanGoal(text=self._spec.prompt, targets=(target,), heading=heading, guidance=self._spec.guidance)

    def _is_near(self, distance_m: float, tick: int) -> bool:
        """Whether to stand now: from a little before the goal on, and not where the stop has missed it."""
        tuning = self._tuning
        if self._near_since is None:
            if distance_m < (tuning.near_m if self._corrections == 0 else tuning.stop_m):
                self._near_since = tick
        elif distance_m > tuning.leave_m and tick - self._near_since >= tuning.stopping_s * TICK_HZ:
            self._near_since = None
            self._corrections += 1
        return self._near_since is not None

    def status(self, trace: Trace) -> Status:
        """Done when the goal was held for half a second."""
        return "done" if self._outcome(trace).met_tick is not None else "running"

    def judge(self, trace: Trace) -> Verdict:
        """Rules of `shared.tasks.rules.reach`."""
        out = self._outcome(trace)
        end = float(np.linalg.norm(trace.pos_w_m[-1, 0, :2] - self.goal_xy_m))
        seconds = trace.duration_s if out.met_tick is None else out.met_tick / TICK_HZ
        measures = {"goal_x_m": float(self.goal_xy_m[0]), "goal_y_m": float(self.goal_xy_m[1]), "end_distance_m": end}
        fell = bool(trace.fallen.any())
        return Verdict(out.strict and not fell, out.paper, out.code, fell, seconds, measures)

    def _outcome(self, trace: Trace) -> rules.ReachOutcome:
        return rules.reach(trace.pos_w_m[:, 0, :2], trace.fallen, self.goal_xy_m)


class HaltTask(Task):
    """Come to a stand and stay there. Strict: at most 0.2 m of drift for the last `duration_s`, and no fall."""

    kind = "halt"

    def __init__(self, spec: HaltSpec):
        self._spec = spec
        self._pace = Pace()
        self._spot: Array | None = None
        self._facing_rad = 0.0

    @property
    def label(self) -> str:
        """`stand still`."""
        return "stand still"

    @property
    def time_limit_s(self) -> float:
        """The time allowed for stopping, the standing time and a margin of a second."""
        return self._spec.settle_s + self._spec.duration_s + 1.0

    def start(self, view: BodyView) -> None:
        """The spot is where the body comes to rest, which is not known yet."""
        self._spot = None
        self._pace.forget()

    def goal(self, view: BodyView, plan_tick: int) -> PlanGoal:
        """Standing; once the body is slow, on the spot where it then is (REFERENCE 3), lest it drift away."""
        mps = self._pace.mps(view)
        if self._spot is None and mps is not None and mps < SLOW_MPS:
            self._spot, self._facing_rad = view.pelvis_xy_m.copy(), view.heading_rad
        if self._spot is None:
            return PlanGoal(text=self._spec.text, guidance=self._spec.guidance)
        spot = (float(self._spot[0]), float(self._spot[1]), 0.0)
        arrival = plan_tick + HOLD_TICKS
        return PlanGoal(
            text=self._spec.text,
            targets=(JointTarget(joint=TRAJ, position_w_m=spot, arrival_tick=arrival),),
            heading=HeadingTarget(heading_rad=self._facing_rad, arrival_tick=arrival),
            guidance=self._spec.guidance,
        )

    def status(self, trace: Trace) -> Status:
        """Done after the stopping and the standing time."""
        return "done" if trace.duration_s >= self._spec.settle_s + self._spec.duration_s else "running"

    def judge(self, trace: Trace) -> Verdict:
        """The release counts a halt as done at once (`code`); here the drift after the stopping time decides."""
        begin = round(self._spec.settle_s * TICK_HZ)
        xy = trace.pos_w_m[:, 0, :2]
        drift = rules.drift_m(xy[begin:]) if len(xy) > begin else float("inf")
        fell = bool(trace.fallen.any())
        still = drift < self._spec.drift_m and trace.duration_s >= self._spec.settle_s + self._spec.duration_s
        measures = {"drift_m": drift} if np.isfinite(drift) else {}
        return Verdict(still and not fell, not fell, True, fell, trace.duration_s, measures)


class TextTask(Task):
    """Do what a sentence says for a while. Strict: the motion shows it (DESIGN 7), and no fall until 1 s after.

    What it says not to do is left out, and where it says one thing after the other ("walk, then wave") each has an
    equal share of the time and is judged by itself (`shared.text.wording`).
    """

    kind = "text"

    def __init__(self, spec: TextSpec):
        self._spec = spec
        self._steps = understand(spec.text).steps
        self._ticks = round(spec.duration_s * TICK_HZ)
        self._start_tick = 0

    @property
    def label(self) -> str:
        """The sentence."""
        return self._spec.text

    @property
    def time_limit_s(self) -> float:
        """Its duration and a margin of a second."""
        return self._spec.duration_s + 1.0

    @property
    def upright(self) -> bool:
        """For all that has a rule; other texts may ask for lying down."""
        return all(kind_of(step) != "other" for step in self._steps)

    def start(self, view: BodyView) -> None:
        """Its steps count from here."""
        self._start_tick = view.tick

    def goal(self, view: BodyView, plan_tick: int) -> PlanGoal:
        """The step that is due, alone."""
        done = sum(plan_tick - self._start_tick >= end for end in self._ends[:-1])
        return PlanGoal(text=self._steps[done], guidance=self._spec.guidance)

    @property
    def _ends(self) -> list[int]:
        """Ticks after the start at which the steps end."""
        return [self._ticks * (i + 1) // len(self._steps) for i in range(len(self._steps))]

    def status(self, trace: Trace) -> Status:
        """Done when its time is over."""
        return "done" if trace.duration_s >= self._spec.duration_s else "running"

    def judge(self, trace: Trace) -> Verdict:
        """Obeyed within its duration; the settling time afterwards only counts for falls."""
        fell, ends = bool(trace.fallen.any()), self._ends
        outcomes = [
            obeyed(step, Trace(trace.start_tick + start, trace.pos_w_m[start:end], trace.fallen[start:end]))
            for step, start, end in zip(self._steps, [0, *ends], ends, strict=False)
        ]
        ok = all(outcome.obeyed for outcome in outcomes) and len(trace) >= self._ticks
        measures = {name: value for outcome in outcomes for name, value in outcome.measures.items()}
        return Verdict(ok and not fell, ok, ok, fell, min(len(trace), self._ticks) / TICK_HZ, measures)
