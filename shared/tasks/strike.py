"""The task `strike`: a blow with a hand or a foot that topples the bag."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from math import atan2, cos, pi, sin

import numpy as np
import numpy.typing as npt

from shared.errors import ConflictError
from shared.motion.rotations import wrap_angle
from shared.protocol.messages import TICK_HZ, HeadingTarget, JointTarget
from shared.scenes.placing import pose_of, top_m
from shared.tasks import object_rules
from shared.tasks.approach import TRAJ, Pace, turn_on_the_spot
from shared.tasks.builtin import HaltTask
from shared.tasks.interface import BodyView, PlanGoal, Status, Task, Trace, Verdict
from shared.tasks.object_specs import Limb, StrikeSpec
from shared.tasks.places import MarkedObject, marked_object
from shared.tasks.specs import HaltSpec
from shared.tasks.touching import Tipping, Upright, is_in, worth_of_blow
from shared.tasks.walking import STILL_MPS, Walk, step_to
from shared.text.wording import STAND_TEXT

Array = npt.NDArray[np.float64]

JOINTS: dict[Limb, str] = {
    "left_hand": "left_wrist", "right_hand": "right_wrist", "left_foot": "left_foot", "right_foot": "right_foot",
}  # fmt: skip
"""What is sent to the target."""
HAND_M = 1.3
"""A fist lands so high where the object is tall enough: the same blow topples more the higher it lands."""


@dataclass(frozen=True)
class Range:
    """From where a limb strikes: distances over the floor of pelvis and object, metres, and seconds to the landing.

    Attributes:
        from_m, to_m, stand_m, blow_s: as in StrikeSpec.
        through_m: the limb is sent so far beyond the mark: it is to go through the object, not to stop at it.
        behind_m: the pelvis is sent to so far before the mark.
        speed_worth: how much the speed of a blow counts, a m/s, when the best of its plans is chosen. The fastest kick
            throws the body (docs/tasks.md).
    """

    from_m: float
    to_m: float
    stand_m: float
    blow_s: float
    through_m: float
    behind_m: float
    speed_worth: float


RANGES = {"hand": Range(0.52, 1.0, 0.8, 0.8, 0.1, 0.5, 0.2), "foot": Range(0.75, 1.3, 1.0, 0.8, 0.05, 0.55, 0.0)}
"""From nearer an arm or a leg has no way to go; from farther a fist comes after the foot that steps."""
CANDIDATES = 12
"""Of so many plans of a blow one is chosen: in most a foot or a hip is at the object before the limb is."""
TIPS: dict[Limb, tuple[str, ...]] = {
    "left_hand": ("left_wrist",), "right_hand": ("right_wrist",),
    "left_foot": ("left_ankle", "left_foot"), "right_foot": ("right_ankle", "right_foot"),
}  # fmt: skip
"""What should be there first; an elbow or a knee belongs to the upper part of its limb too."""
PUSH_M, PUSH_S = 0.6, 4.0
PUSH_MPS, PUSH_MPS2, MOST_PUSH_MPS = 0.55, 0.12, 0.8
PUSH_TEXT = "a person is walking forward."
ARM_M = 0.45
"""After the blow the body walks on into the object, to so far beyond where it was, a hand ahead: the
longer it takes, the faster, but who walks faster falls with what falls: of 35 who did at 0.7 to 1 m/s 29 stood at
these speeds."""
AWAY_M, AWAY_S = 0.35, 1.0
"""From what goes down a body goes so far back, for so long, before it stands: of those 35, 12 stood by that alone."""
TOUCHED_M, TOUCHED_RAD = 0.015, 0.02
"""An object that has moved or leans so much has been hit."""
TOP_ROOM_M = 0.3
LEAST_TICKS = 12
"""A target is never asked for sooner (frame 8 of a plan)."""
BLOW_HOLD_TICKS, PUSH_REPLAN_TICKS = 42, 6
"""A blow's plan is performed until it has landed, which is later than it was asked to: made anew on the way, it begins
with the wind-up again. Who pushes must know soon that the bag goes: planned for every half second 30 of 200 fell,
every fifth of one 18."""
GOING_RAD = 0.30
"""Beyond this lean, well past its edge, the bag goes down by itself."""
LEAN_TICKS = 2
"""Over so long the rate of its lean is told."""
LANDED_S = 0.5
"""So long after a blow should have landed the next one is thought of."""
FALLS_S = 2.0
"""Where it cannot be seen, what has been pushed over is given so long to lie."""
TURN_FROM_RAD = 0.5
WALK_FROM_M = 0.36
"""Farther than this from where it should stand it walks; nearer it takes a step."""
LEAST_STEP_M = 0.28
"""Shorter steps than this are asked for and not taken."""
ROOM_M = 0.75
"""An object that is set up again stands at least so far from the body."""


class StrikeTask(Task):
    """Go to a distance from which the limb reaches, strike, go on into what was hit, and after a miss step back and
    strike again.

    What a fist or a foot gives from a stand is less than it takes to topple a heavy bag (docs/scenes.md): the limb hits
    first, and the body behind it goes through until the object is past its edge.
    """

    kind = "strike"

    def __init__(self, spec: StrikeSpec):
        self._spec = spec
        self._bag: MarkedObject | None = None
        self._walk = Walk(spec.guidance)
        self._stand = HaltTask(HaltSpec(guidance=spec.guidance))
        self._lands_tick: int | None = None
        self._hit_tick: int | None = None
        self._blow_tick, self._felt = 0, False
        self._gone: tuple[int, Array] | None = None
        self._tipping: Tipping | None = None
        self._lean_radps = 0.0
        self._stood, self._way = np.zeros(3), np.zeros(2)
        self._scale, self._blows = 1.0, 0
        self._over_tick: int | None = None
        self._pace = Pace()
        self._walking = False
        self._range = RANGES[spec.limb.split("_")[1]]

    @property
    def label(self) -> str:
        """E.g. `strike with the left foot`."""
        return f"strike with the {self._spec.limb.replace('_', ' ')}"

    @property
    def time_limit_s(self) -> float:
        """From the spec."""
        return self._spec.time_limit_s

    def props(self, view: BodyView) -> Mapping[str, Array]:
        """A bag that does not stand is set up where the scene has it, or ahead where the body is in the way."""
        bag = marked_object(view, self._spec.mark)
        pose = view.objects.get(bag.object)
        body = bag.scene.body(bag.object)
        if pose is None or body is None or object_rules.tilt_rad(pose) < object_rules.PAPER_TILT_RAD:
            return {}
        place = pose_of(body).astype(np.float64)
        if float(np.linalg.norm(place[:2] - view.pelvis_xy_m)) < ROOM_M * view.scale:
            ahead = np.array([cos(view.heading_rad), sin(view.heading_rad)])
            place[:2] = view.pelvis_xy_m + self._told("stand_m") * view.scale * ahead
        return {bag.object: place}

    def start(self, view: BodyView) -> None:
        """Find what to hit; raises InvalidInputError where the scene has no such mark."""
        self._bag = marked_object(view, self._spec.mark)
        self._stand.start(view)
        self._lands_tick, self._hit_tick, self._blows = None, None, 0
        body = self._bag.scene.body(self._bag.object)
        self._tipping, self._lean_radps = None if body is None else Tipping.of(body), 0.0
        self._walking, self._gone = False, None
        self._scale, self._over_tick = view.scale, None
        self._pace.forget()

    def goal(self, view: BodyView, plan_tick: int) -> PlanGoal:
        """To the bag, back from it, the blow whose arrival tick counts down, or through it; standing once it goes."""
        told = self._deed(view, plan_tick)
        if told is None:
            return self._stand.goal(view, plan_tick)
        self._stand.start(view)  # where it stood before is no place to go back to
        return told

    def _deed(self, view: BodyView, plan_tick: int) -> PlanGoal | None:
        """What is to be done now; None: come to rest."""
        mps = self._pace.mps(view)
        moving = mps is not None and mps > STILL_MPS * view.scale
        spec, bag = self._spec, self._known()
        pose = view.objects.get(bag.object)
        gone = pose is not None and self._goes(float(object_rules.tilt_rad(pose)))
        if gone or self._over_tick is not None:
            return self._from_it(view, plan_tick)
        self._gone = None
        place = bag.place(view).position_w_m.astype(np.float64)
        if self._lands_tick is not None:
            if self._hit_tick is None and self._was_hit(place, pose):
                self._hit_tick = plan_tick
            if self._hit_tick is not None and plan_tick < self._hit_tick + PUSH_S * TICK_HZ:
                return self._push(view, plan_tick)
            if self._hit_tick is None and plan_tick < self._lands_tick + LANDED_S * TICK_HZ:
                return self._blow(view, plan_tick)
            self._lands_tick = self._hit_tick = None
        away = place[:2] - view.pelvis_xy_m
        distance = float(np.linalg.norm(away)) / view.scale
        way = away / max(float(np.linalg.norm(away)), 1e-6)
        bearing = float(wrap_angle(atan2(away[1], away[0]) - view.heading_rad))
        stand_m, near_m, far_m = (self._told(name) for name in ("stand_m", "from_m", "to_m"))
        if distance - stand_m > WALK_FROM_M:
            self._walking = True
        elif not moving:
            self._walking = False
        if self._walking:
            return self._walk.goal(view, place[:2] - way * stand_m * view.scale, plan_tick)
        if moving:
            return None
        if not near_m <= distance <= far_m and abs(bearing) <= TURN_FROM_RAD:
            ahead_m = distance - stand_m
            gone_m = max(ahead_m, LEAST_STEP_M) if distance > far_m else min(ahead_m, -LEAST_STEP_M)
            spot = view.pelvis_xy_m + way * gone_m * view.scale
            return step_to(view, spot, atan2(way[1], way[0]), plan_tick, spec.guidance)
        if abs(bearing) > TURN_FROM_RAD:
            return turn_on_the_spot(view, plan_tick, bearing, spec.guidance)
        self._lands_tick, self._hit_tick = plan_tick + round(self._told("blow_s") * TICK_HZ), None
        self._blow_tick, self._felt = plan_tick, False
        self._stood, self._way = place, way
        self._blows += 1
        return self._blow(view, plan_tick)

    def _told(self, name: str) -> float:
        """A distance or time of the spec, or what suits the limb."""
        own = getattr(self._spec, name)
        return float(getattr(self._range, name) if own is None else own)

    def _goes(self, lean_rad: float) -> bool:
        """Whether it goes down by itself: past its edge, or fast enough to get there."""
        moving = self._tipping is not None and self._tipping.goes(lean_rad, self._lean_radps)
        return lean_rad >= GOING_RAD or moving

    def _was_hit(self, place: Array, pose: Array | None) -> bool:
        """Felt in the limb, or seen: a heavy object that a kick meets low does not move."""
        moved = float(np.linalg.norm(place - self._stood))
        return (
            self._felt or moved > TOUCHED_M or (pose is not None and float(object_rules.tilt_rad(pose)) > TOUCHED_RAD)
        )

    def _through(self, height_m: float, beyond_m: float) -> Array:
        """(3,) a point so far beyond where the mark was when the blow began."""
        x, y = self._stood[:2] + self._way * beyond_m
        return np.array([x, y, height_m])

    def _height_m(self, scale: float, hand: bool) -> float:
        """Where to hit: as asked for, else at the mark, and with a hand higher where the object is tall."""
        if self._spec.height_m is not None:
            return self._spec.height_m
        body = self._known().scene.body(self._known().object)
        mark = float(self._stood[2])
        return max(mark, min(HAND_M * scale, top_m(body) - TOP_ROOM_M)) if hand and body is not None else mark

    def _blow(self, view: BodyView, plan_tick: int) -> PlanGoal:
        """The limb through the mark at the tick that was set when the blow began."""
        assert self._lands_tick is not None
        limb, lands = self._spec.limb, max(self._lands_tick, plan_tick + 1)
        hand, own = limb.endswith("hand"), self._range
        x, y, z = (float(v) for v in self._through(self._height_m(view.scale, hand), own.through_m * view.scale))
        rx, ry, _ = (float(v) for v in self._through(0.0, -own.behind_m * view.scale))
        solid = self._solid()
        return PlanGoal(
            text=self._spec.prompt,
            targets=(
                JointTarget(joint=JOINTS[limb], position_w_m=(x, y, z), arrival_tick=lands),
                JointTarget(joint=TRAJ, position_w_m=(rx, ry, 0.0), arrival_tick=lands),
            ),
            heading=self._facing(lands),
            # Told twice the planner's limb gets farther than told either way.
            keyframe_ticks=(lands,),
            keyframe_joints=((JOINTS[limb],),),
            keyframe_positions_w_m=(((x, y, z),),),
            guidance=self._spec.guidance,
            hold_ticks=BLOW_HOLD_TICKS,
            candidates=CANDIDATES,
            worth=None if solid is None else partial(
                worth_of_blow, scale=view.scale, solid=solid, limb=TIPS[limb], speed_worth=own.speed_worth
            ),
        )  # fmt: skip

    def _solid(self) -> Upright | None:
        """The object as it stood when the blow began."""
        body = self._known().scene.body(self._known().object)
        return None if body is None else Upright.of(body, self._stood[:2])

    def _push(self, view: BodyView, plan_tick: int) -> PlanGoal:
        """Walk on into what was hit, a hand ahead: the one that hit it, or that of the same side as the foot."""
        self._aim(view)
        x, y, _ = (float(v) for v in self._through(0.0, PUSH_M * view.scale))
        far_m = float(np.linalg.norm(np.array([x, y]) - view.pelvis_xy_m)) / view.scale
        since_s = (plan_tick - (self._hit_tick or plan_tick)) / TICK_HZ
        mps = min(PUSH_MPS + PUSH_MPS2 * since_s, MOST_PUSH_MPS)
        arrives = plan_tick + min(max(round(far_m / mps * TICK_HZ), LEAST_TICKS), 2 * TICK_HZ)
        hand = self._through(self._height_m(view.scale, hand=True), (PUSH_M + ARM_M) * view.scale)
        joint = f"{self._spec.limb.split('_')[0]}_wrist"
        hx, hy, hz = (float(v) for v in hand)
        return PlanGoal(
            text=PUSH_TEXT,
            targets=(
                JointTarget(joint=TRAJ, position_w_m=(x, y, 0.0), arrival_tick=arrives),
                JointTarget(joint=joint, position_w_m=(hx, hy, hz), arrival_tick=arrives),
            ),
            heading=self._facing(arrives),
            guidance=self._spec.guidance,
            replan_ticks=PUSH_REPLAN_TICKS,
        )

    def _from_it(self, view: BodyView, plan_tick: int) -> PlanGoal | None:
        """Back from what goes down, for a while; then None."""
        if self._hit_tick is None:
            return None
        if self._gone is None:
            self._gone = plan_tick, view.pelvis_xy_m - self._way * AWAY_M * view.scale
        since, spot = self._gone
        if plan_tick >= since + AWAY_S * TICK_HZ:
            return None
        x, y = (float(v) for v in spot)
        arrival = plan_tick + TICK_HZ
        return PlanGoal(
            text=STAND_TEXT,
            targets=(JointTarget(joint=TRAJ, position_w_m=(x, y, 0.0), arrival_tick=arrival),),
            heading=self._facing(arrival),
            guidance=self._spec.guidance,
        )

    def _aim(self, view: BodyView) -> None:
        """Through where the object is now, not where it was: a body that goes straight on slips past it."""
        place = self._known().place(view).position_w_m.astype(np.float64)
        away = place[:2] - view.pelvis_xy_m
        if float(away @ self._way) > 0:
            self._stood = np.array([*place[:2], self._stood[2]])
            self._way = away / max(float(np.linalg.norm(away)), 1e-6)

    def _facing(self, arrival_tick: int) -> HeadingTarget:
        return HeadingTarget(heading_rad=atan2(self._way[1], self._way[0]), arrival_tick=arrival_tick)

    def status(self, trace: Trace) -> Status:
        """Done when the bag is down and the limb was first; failed when it is down by anything else."""
        if trace.world is not None and not trace.world.felt:
            return self._imagined(trace)
        blow = self._judged(trace)
        if trace.world is not None and blow is not None and len(trace) > LEAN_TICKS:
            bag = trace.world.objects.index(self._known().object)
            before, now = object_rules.tilt_rad(trace.world.pose_w[[-1 - LEAN_TICKS, -1], bag])
            self._lean_radps = float(now - before) * TICK_HZ / LEAN_TICKS
        if trace.world is not None and blow is not None and self._lands_tick is not None:
            limb = trace.world.impulse_ns(self._known().object, object_rules.LIMBS[self._spec.limb])
            self._felt |= bool((limb[max(self._blow_tick - trace.start_tick, 0) :] > 0).any())
        if blow is None or not blow.outcome.code:
            return "running"
        return "done" if blow.outcome.met_tick is not None else "failed"

    def _imagined(self, trace: Trace) -> Status:
        """By what is planned alone: what the limb is in was hit; what the pelvis has gone through after that was pushed
        over."""
        solid, now = self._solid(), trace.start_tick + len(trace) - 1
        if solid is not None and self._lands_tick is not None:
            struck = trace.since(self._blow_tick).pos_w_m
            self._felt |= is_in(struck, self._scale, solid, TIPS[self._spec.limb])
            if self._over_tick is None and self._hit_tick is not None:
                pushed = trace.since(self._hit_tick).pos_w_m
                was, still = (is_in(part, self._scale, solid, ("pelvis",)) for part in (pushed, pushed[-1:]))
                self._over_tick = now if was and not still else None
        over = self._over_tick is not None and now - self._over_tick >= FALLS_S * TICK_HZ
        return "done" if over else "running"

    def judge(self, trace: Trace) -> Verdict:
        """Rules of `shared.tasks.object_rules.strike`."""
        fell, blow = bool(trace.fallen.any()), self._judged(trace)
        if blow is None:
            return Verdict(False, False, False, fell, trace.duration_s, {})
        out = blow.outcome
        measures = {
            "tilt_deg": blow.most_tilt_rad * 180 / pi,
            "limb_first": float(blow.limb_first),
            "blows": float(self._blows),
        }
        if blow.first_tick is not None:
            measures["first_touch_s"] = blow.first_tick / TICK_HZ
        seconds = trace.duration_s if out.met_tick is None else out.met_tick / TICK_HZ
        return Verdict(out.strict and not fell, out.paper, out.code, fell, seconds, measures)

    def _judged(self, trace: Trace) -> object_rules.Blow | None:
        bag = self._known().object
        if trace.world is None or not len(trace) or bag not in trace.world.objects:
            return None
        return object_rules.strike(trace.world, trace.fallen, bag, self._spec.limb)

    def _known(self) -> MarkedObject:
        if self._bag is None:
            raise ConflictError("the task was not started, what to hit is not known yet")
        return self._bag
