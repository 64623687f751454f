"""The tasks `sit` and `get_up`."""

from __future__ import annotations

from math import cos, sin

import numpy as np
import numpy.typing as npt

from shared.errors import ConflictError
from shared.motion.rotations import wrap_angle
from shared.motion.skeleton import CANONICAL
from shared.protocol.messages import TICK_HZ, HeadingTarget, JointTarget
from shared.scenes.placing import Place
from shared.tasks import object_rules
from shared.tasks.approach import Approach, Pace, turn_on_the_spot
from shared.tasks.builtin import HaltTask
from shared.tasks.interface import RISE_PLANNER, BodyView, PlanGoal, Posture, Status, Task, Trace, Verdict
from shared.tasks.object_specs import GetUpSpec, SitSpec
from shared.tasks.places import MarkedObject, marked_object
from shared.tasks.specs import HaltSpec, ReachTuning
from shared.tasks.walking import STILL_MPS, Walk

Array = npt.NDArray[np.float64]
PELVIS = CANONICAL.index("pelvis")
FRONT_M, AWAY_M = 0.35, 0.65
"""Nearer than the first to the place before the seat it turns round, and goes there again from beyond the second: who
turns strays."""
FACING_RAD = 0.6
FROM_EDGE_M = 0.25
"""So far behind the seat's edge the pelvis is put: a little more than in the motion that sits and rises are learnt
from (0.2 m), where the seat ends behind the body and nobody slides off its front."""
HIGH_SEAT_M, DEEPER_M = (0.45, 0.6), 0.1
"""Over these heights of a seat it is put so much farther in: on a high one no foot holds who sits on the edge."""
ELBOW_ROOM_M = 0.3
ON_IT_M, SEATED_M = 0.15, 0.08
"""A pelvis less than this above where it should be is on the seat, and sits."""
SEATED_TEXT = "a person is sitting."
SIT_S, TRY_S = 2.0, 6.0
"""How long sitting down takes; after so long without a seat under it, it begins anew."""
LOW_SHARE = 0.75
"""A pelvis below this share of its standing height sits or lies."""
RISE = ReachTuning(speed_mps=0.4, least_arrival_s=0.8)
HOLD_TICKS = 45
"""Planned anew every half second a rise begins again and again: the body leans forward, and forward, and sits."""
UP_SHARE = 0.85
"""Below this share of its standing height a pelvis is still on its way up."""
SOLES = CANONICAL.indices("left_ankle", "right_ankle", "left_foot", "right_foot")
SIDE_M = 0.45
AHEAD_M = 0.3


def front_of(seat: MarkedObject, view: BodyView) -> Array:
    """(2,) where one stands before the seat: its mark `X_front`, else 0.3 m before its edge."""
    name = seat.name.removesuffix("_centre") + "_front"
    if name in seat.scene.marks:
        return np.asarray(seat.place(view, name).position_w_m[:2], dtype=np.float64)
    return before_edge(seat, view, AHEAD_M)


def before_edge(seat: MarkedObject, view: BodyView, ahead_m: float) -> Array:
    """(2,) a place so far before the seat's front edge."""
    place = seat.place(view)
    out = np.array([cos(place.heading_rad), sin(place.heading_rad)])
    return np.asarray(place.position_w_m[:2] + out * (seat.half_size_m[0] + ahead_m))


def place_on(seat: MarkedObject, view: BodyView) -> Array:
    """(2,) where on a seat to sit down: straight behind the body, and not farther in than the feet can stay under it.

    Who sits deep in a wide seat leans back with the feet far ahead, and does not get up again.
    """
    place = seat.place(view)
    out = np.array([cos(place.heading_rad), sin(place.heading_rad)])
    left = np.array([-out[1], out[0]])
    along, across = seat.half_size_m
    most = max(across - ELBOW_ROOM_M, 0.0)
    aside = float(np.clip((view.pelvis_xy_m - place.position_w_m[:2]) @ left, -most, most))
    top = float(place.position_w_m[2]) / view.scale
    deep = FROM_EDGE_M + float(np.interp(top, HIGH_SEAT_M, (0.0, DEEPER_M)))
    return np.asarray(place.position_w_m[:2] + out * max(along - deep * view.scale, 0.0) + left * aside)


def way_round(place: Place, half_size_m: tuple[float, float], here_xy_m: Array, front_xy_m: Array) -> Array:
    """(2,) the next place on the way to the front of a seat from any side: past its corner where it is between."""
    out = np.array([cos(place.heading_rad), sin(place.heading_rad)])
    left = np.array([-out[1], out[0]])
    centre = np.asarray(place.position_w_m[:2], dtype=np.float64)
    away = here_xy_m - centre
    ahead, aside = float(away @ out), float(away @ left)
    clear = half_size_m[1] + SIDE_M
    if ahead >= half_size_m[0]:
        return front_xy_m
    side = clear if aside >= 0 else -clear
    if abs(aside) < clear - 0.15:
        return np.asarray(centre + left * side * 1.1 + out * ahead)
    return np.asarray(centre + left * side * 1.1 + out * float((front_xy_m - centre) @ out))


class SitTask(Task):
    """To the front of a seat, turn round, sit down, stay seated."""

    kind = "sit"

    def __init__(self, spec: SitSpec):
        self._spec = spec
        self._seat: MarkedObject | None = None
        self._mass_kg = 0.0
        self._walk = Walk(spec.guidance)
        self._pace = Pace()
        self._there = False
        self._begun_tick: int | None = None
        self._aim: Array | None = None
        self._spot: Array | None = None

    @property
    def label(self) -> str:
        """E.g. `sit on seat_centre`."""
        return f"sit on {self._spec.mark}"

    @property
    def time_limit_s(self) -> float:
        """From the spec."""
        return self._spec.time_limit_s

    @property
    def posture(self) -> Posture:
        """It ends seated."""
        return "seated"

    def start(self, view: BodyView) -> None:
        """Find the seat; raises InvalidInputError where the scene has no such mark."""
        self._seat, self._mass_kg = marked_object(view, self._spec.mark), view.mass_kg
        self._begun_tick = self._aim = self._spot = None
        self._there = False
        self._pace.forget()

    def goal(self, view: BodyView, plan_tick: int) -> PlanGoal:
        """To the front, round, and down: the pelvis aimed above the seat's top, facing away from the seat; there it
        stays."""
        spec, seat, mps = self._spec, _known(self._seat), self._pace.mps(view)
        place = seat.place(view)
        pelvis = view.pos_w_m[PELVIS]
        top = float(place.position_w_m[2]) + spec.above_m * view.scale
        aim = self._aim if self._aim is not None else place_on(seat, view)
        on_it = pelvis[2] < top + ON_IT_M and float(np.linalg.norm(pelvis[:2] - aim)) < max(seat.half_size_m)
        if self._begun_tick is not None and plan_tick - self._begun_tick > TRY_S * TICK_HZ and not on_it:
            self._begun_tick = self._aim = None
        if self._begun_tick is None and not on_it:
            front = front_of(seat, view)
            through = way_round(place, seat.half_size_m, view.pelvis_xy_m, front)
            self._there = float(np.linalg.norm(front - view.pelvis_xy_m)) <= view.scale * (
                AWAY_M if self._there else FRONT_M
            )
            if not self._there:
                return self._walk.goal(view, through, plan_tick)
            turn = float(wrap_angle(place.heading_rad - view.heading_rad))
            if abs(turn) > FACING_RAD:
                if mps is not None and mps > STILL_MPS * view.scale:
                    return self._walk.goal(view, front, plan_tick)
                return turn_on_the_spot(view, plan_tick, turn, spec.guidance)
        if self._begun_tick is None:
            self._begun_tick, self._aim = plan_tick, place_on(seat, view)
            aim = self._aim
        seated = on_it and pelvis[2] < top + SEATED_M and _over(seat, view)
        if seated and self._spot is None:
            self._spot = view.pelvis_xy_m.copy()
        if not seated:
            self._spot = None
        x, y = (float(v) for v in (aim if self._spot is None else self._spot))
        lasts = self._begun_tick + round(SIT_S * TICK_HZ) - plan_tick
        arrival = plan_tick + max(lasts, TICK_HZ // 2)
        return PlanGoal(
            text=spec.text if self._spot is None else SEATED_TEXT,
            targets=(JointTarget(joint="pelvis", position_w_m=(x, y, top), arrival_tick=arrival),),
            heading=HeadingTarget(heading_rad=place.heading_rad, arrival_tick=arrival),
            guidance=spec.guidance,
            hold_ticks=HOLD_TICKS if self._spot is None and lasts > 0 else 0,
        )

    def status(self, trace: Trace) -> Status:
        """Done when the seat has carried it for half a second."""
        return "done" if self._outcome(trace).met_tick is not None else "running"

    def judge(self, trace: Trace) -> Verdict:
        """Rules of `shared.tasks.object_rules.sit`."""
        out, seat, fell = self._outcome(trace), _known(self._seat), bool(trace.fallen.any())
        measures: dict[str, float] = {}
        if trace.world is not None and len(trace):
            x, y, z = (float(v) for v in seat.local_m(trace.world, trace.pos_w_m[:, PELVIS])[-1])
            share = object_rules.seat_share(trace.world, seat.object, self._mass_kg)
            measures = {"ahead_m": x, "left_m": y, "above_m": z, "most_share": float(share.max())}
        seconds = trace.duration_s if out.met_tick is None else out.met_tick / TICK_HZ
        return Verdict(out.strict and not fell, out.paper, out.code, fell, seconds, measures)

    def _outcome(self, trace: Trace) -> object_rules.Outcome:
        return object_rules.sit(trace, _known(self._seat), self._mass_kg)


class GetUpTask(Task):
    """Up from a seat, to a place before it, or from the floor, where it lies; then stand."""

    kind = "get_up"

    def __init__(self, spec: GetUpSpec):
        self._spec = spec
        self._target: Array | None = None
        self._facing_rad: float | None = None
        self._seat: MarkedObject | None = None
        self._sit: SitTask | None = None
        self._begin_tick = 0
        self._was_low, self._scale = False, 1.0
        self._approach = Approach("pelvis", RISE)
        self._stand = HaltTask(HaltSpec(guidance=spec.guidance))
        self._walk = Walk(spec.guidance)

    @property
    def label(self) -> str:
        """E.g. `get up from the seat`."""
        return f"get up from the {self._spec.from_}"

    @property
    def time_limit_s(self) -> float:
        """From the spec, and as long again as `sit` has where that may come first."""
        return self._spec.time_limit_s + (SitSpec().time_limit_s if self._spec.sit_first else 0.0)

    @property
    def upright(self) -> bool:
        """Not where it begins on the floor."""
        return self._spec.from_ == "seat"

    @property
    def posture(self) -> Posture:
        """On the floor a fall is told by the task itself."""
        return "upright" if self._spec.from_ == "seat" else "from_floor"

    @property
    def target_w_m(self) -> Array:
        """(3,) where the pelvis should be; raises ConflictError before the rise has begun, which fixes it."""
        if self._target is None:
            raise ConflictError("the rise has not begun, its target is not known yet")
        return self._target

    def start(self, view: BodyView) -> None:
        """Fix the place, or sit down first; raises InvalidInputError where the scene has no such seat."""
        spec = self._spec
        self._target, self._sit, self._begin_tick = None, None, view.tick
        self._scale = view.scale
        self._seat = marked_object(view, spec.mark) if spec.from_ == "seat" else None
        low = bool(view.pos_w_m[PELVIS, 2] < LOW_SHARE * spec.height_m * view.scale)
        self._was_low = low or (self._seat is not None and _sits_on(self._seat, view))
        if self._seat is not None and spec.sit_first and not self._was_low:
            self._sit = SitTask(SitSpec(mark=spec.mark, guidance=spec.guidance))
            self._sit.start(view)
        else:
            self._begin(view)

    def _begin(self, view: BodyView) -> None:
        """Where to stand: ahead of the edge of the seat, or where it lies."""
        xy, self._facing_rad, seat = view.pelvis_xy_m, None, self._seat
        if seat is not None:
            place = seat.place(view)
            # A wide seat is left straight ahead from where one sits on it.
            left = np.array([-sin(place.heading_rad), cos(place.heading_rad)])
            aside = float((view.pelvis_xy_m - place.position_w_m[:2]) @ left)
            aside = float(np.clip(aside, -seat.half_size_m[1], seat.half_size_m[1]))
            xy, self._facing_rad = before_edge(seat, view, self._spec.ahead_m) + left * aside, place.heading_rad
        self._target = np.array([xy[0], xy[1], self._spec.height_m * view.scale])
        self._approach.forget()
        self._stand.start(view)

    def goal(self, view: BodyView, plan_tick: int) -> PlanGoal:
        """The pelvis up over the feet, then to the place; standing once it is there.

        Nobody gets up into the air: where the place lies ahead of the feet, a step follows once the body stands.
        """
        if self._sit is not None:
            return self._sit.goal(view, plan_tick)
        if self._target is None:
            self._begin(view)
        pelvis, target = view.pos_w_m[PELVIS], self.target_w_m
        if float(np.linalg.norm(pelvis - target)) < 0.2 * view.scale:
            return self._stand.goal(view, plan_tick)
        self._stand.start(view)
        if pelvis[2] >= UP_SHARE * target[2]:
            return self._walk.goal(view, target[:2], plan_tick)
        if self._spec.from_ == "floor":
            return self._off_the_floor(view, plan_tick)
        over_feet = np.array([*view.pos_w_m[SOLES, :2].mean(axis=0), target[2]])
        aim = self._approach.target(pelvis, over_feet, plan_tick, view.scale)
        heading = None
        if self._facing_rad is not None:
            heading = HeadingTarget(heading_rad=self._facing_rad, arrival_tick=aim.arrival_tick)
        return PlanGoal(
            text=self._spec.prompt, targets=(aim,), heading=heading, guidance=self._spec.guidance, hold_ticks=HOLD_TICKS
        )

    def _off_the_floor(self, view: BodyView, plan_tick: int) -> PlanGoal:
        """By a known way up, unless other words are asked for: those are the character's own planner's."""
        if self._spec.text is None:
            return PlanGoal(text=self._spec.prompt, may_be_low=True, planner=RISE_PLANNER)
        aim = self._approach.target(view.pos_w_m[PELVIS], self.target_w_m, plan_tick, view.scale)
        return PlanGoal(text=self._spec.prompt, targets=(aim,), guidance=self._spec.guidance, may_be_low=True)

    def status(self, trace: Trace) -> Status:
        """Done when it has stood on both feet for half a second."""
        if self._sit is not None and self._sit.status(trace) == "done":
            self._sit, self._was_low, self._begin_tick = None, True, trace.start_tick + len(trace)
        if self._target is None:
            return "running"
        return "done" if self._outcome(trace).met_tick is not None else "running"

    def judge(self, trace: Trace) -> Verdict:
        """Rules of `shared.tasks.object_rules.get_up`; `was_low`: the release counts only those that sat before."""
        was_low = self._was_low and self._low_in(trace)
        measures = {"was_low": float(was_low)}
        if self._target is None:
            return Verdict(False, False, False, bool(trace.fallen.any()), trace.duration_s, measures)
        out, floor = self._outcome(trace), self._spec.from_ == "floor"
        fell = bool(trace.fallen.any()) if not floor else out.met_tick is not None and not out.strict
        if len(trace):
            measures["end_distance_m"] = float(np.linalg.norm(trace.pos_w_m[-1, PELVIS] - self.target_w_m))
        seconds = trace.duration_s if out.met_tick is None else out.met_tick / TICK_HZ
        strict = out.strict and was_low and (floor or not fell)
        return Verdict(strict, out.paper, out.code, fell, seconds, measures)

    def _low_in(self, trace: Trace) -> bool:
        """Whether the body of a trace was low, or on the seat: what an open loop takes for true need not be."""
        low = trace.pos_w_m[:, PELVIS, 2] < LOW_SHARE * self._spec.height_m * self._scale
        if self._seat is None:
            return bool(low.any())
        if trace.world is None:
            return True
        along, across, above = self._seat.local_m(trace.world, trace.pos_w_m[:, PELVIS]).T
        over = (np.abs(along) <= self._seat.half_size_m[0]) & (np.abs(across) <= self._seat.half_size_m[1])
        return bool((low | (over & (above < (SitSpec().above_m + SEATED_M) * self._scale))).any())

    def _outcome(self, trace: Trace) -> object_rules.Outcome:
        """Of the rise alone, where sitting down came before it."""
        return object_rules.get_up(trace.since(self._begin_tick), self.target_w_m, self._spec.from_ == "floor")


def _sits_on(seat: MarkedObject, view: BodyView) -> bool:
    """Whether the pelvis is over a seat and as near to its top as a sitter's, on a seat too high to be low."""
    above = float(view.pos_w_m[PELVIS, 2]) - float(seat.place(view).position_w_m[2])
    return _over(seat, view) and above < (SitSpec().above_m + SEATED_M) * view.scale


def _over(seat: MarkedObject, view: BodyView) -> bool:
    """Whether the pelvis is over the seat's area."""
    place = seat.place(view)
    out = np.array([cos(place.heading_rad), sin(place.heading_rad)])
    away = view.pelvis_xy_m - place.position_w_m[:2]
    return bool((np.abs([away @ out, away @ np.array([-out[1], out[0]])]) <= seat.half_size_m).all())


def _known(seat: MarkedObject | None) -> MarkedObject:
    if seat is None:
        raise ConflictError("the task was not started, the seat is not known yet")
    return seat
