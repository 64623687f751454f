"""The task `strike`: a blow with a hand or a foot that topples the bag."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import atan2, cos, pi, sin

import numpy as np
import numpy.typing as npt

from shared.errors import ConflictError
from shared.motion.rotations import wrap_angle
from shared.motion.skeleton import CANONICAL
from shared.protocol.messages import TICK_HZ, HeadingTarget, JointTarget
from shared.scenes.placing import pose_of, top_m
from shared.tasks import object_rules
from shared.tasks.approach import stepped_target, turn_on_the_spot
from shared.tasks.builtin import HaltTask
from shared.tasks.interface import BodyView, PlanGoal, Status, Task, Trace, Verdict
from shared.tasks.object_specs import Limb, StrikeSpec
from shared.tasks.places import MarkedObject, marked_object
from shared.tasks.specs import HaltSpec
from shared.tasks.walking import Walk, step_back

Array = npt.NDArray[np.float64]

JOINTS: dict[Limb, str] = {
    "left_hand": "left_wrist", "right_hand": "right_wrist", "left_foot": "left_foot", "right_foot": "right_foot",
}  # fmt: skip
"""What is sent to the target."""
STEP_M = 1.3
STEP_MPS = 1.0
REACH_M = 0.8
"""From the pelvis a hand or foot comes so far without a step."""
HAND_M = 1.3
"""A fist lands so high where the object is tall enough: the same blow topples more the higher it lands."""
THROUGH_M = {"hand": 0.15, "foot": 0.05}
"""The limb is sent so far beyond the mark: it is to go through the object, not to stop at it."""
PUSH_M = 0.9
PUSH_S = 1.6
PUSH_ARRIVES_S = 1.0
"""After the blow the body goes on into the object for a while, a hand so far beyond where the mark was."""
PUSH_TEXT = "a person steps forward and punches."
TOUCHED_M, TOUCHED_RAD = 0.015, 0.02
"""An object that has moved or leans so much has been hit."""
TOP_ROOM_M = 0.3
LEAST_TICKS = 12
"""A target is never asked for sooner (frame 8 of a plan)."""
AFTER_TICKS, MOST_HELD_TICKS, PUSH_HOLD_TICKS = 3, 45, 24
"""A blow's plan is performed until it has landed: made anew on the way, it begins with the wind-up again."""
GOING_RAD = 0.45
"""Beyond this lean, well past its edge, the bag goes down by itself."""
LANDED_S = 0.8
"""So long after a blow should have landed the next one is thought of."""
TURN_FROM_RAD = 0.6
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
        self._stood, self._way = np.zeros(3), np.zeros(2)
        self._blows = 0
        self._back = False

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
            place[:2] = view.pelvis_xy_m + self._spec.stand_m * view.scale * ahead
        return {bag.object: place}

    def start(self, view: BodyView) -> None:
        """Find what to hit; raises InvalidInputError where the scene has no such mark."""
        self._bag = marked_object(view, self._spec.mark)
        self._stand.start(view)
        self._lands_tick, self._hit_tick, self._blows, self._back = None, None, 0, False

    def goal(self, view: BodyView, plan_tick: int) -> PlanGoal:
        """To the bag, back from it, the blow whose arrival tick counts down, or through it; standing once it goes."""
        spec, bag = self._spec, self._known()
        pose = view.objects.get(bag.object)
        if pose is not None and float(object_rules.tilt_rad(pose)) >= GOING_RAD:
            return self._stand.goal(view, plan_tick)
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
        bearing = float(wrap_angle(atan2(away[1], away[0]) - view.heading_rad))
        self._back = distance < (0.9 * spec.stand_m if self._back else spec.from_m)
        if self._back:
            return step_back(view, place[:2], spec.stand_m * view.scale, plan_tick, spec.guidance)
        if distance > spec.to_m:
            before = place[:2] - away / np.linalg.norm(away) * spec.stand_m * view.scale
            return self._walk.goal(view, before, plan_tick)
        if abs(bearing) > TURN_FROM_RAD:
            return turn_on_the_spot(view, plan_tick, bearing, spec.guidance)
        seconds = min(spec.blow_s + max(0.0, distance - REACH_M) / STEP_MPS, 2.0)
        self._lands_tick, self._hit_tick = plan_tick + round(seconds * TICK_HZ), None
        self._blow_tick, self._felt = plan_tick, False
        self._stood, self._way = place, away / np.linalg.norm(away)
        self._blows += 1
        return self._blow(view, plan_tick)

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
        end = limb.split("_")[1]
        goal = self._through(self._height_m(view.scale, end == "hand"), THROUGH_M[end] * view.scale)
        told = self._limb_to(view, goal, JOINTS[limb], lands, self._spec.prompt, plan_tick)
        return replace(told, hold_ticks=min(lands - plan_tick + AFTER_TICKS, MOST_HELD_TICKS))

    def _push(self, view: BodyView, plan_tick: int) -> PlanGoal:
        """On into what was hit, a hand ahead: the one that hit it, or that of the same side as the foot."""
        assert self._hit_tick is not None
        joint = f"{self._spec.limb.split('_')[0]}_wrist"
        goal = self._through(self._height_m(view.scale, hand=True), PUSH_M * view.scale)
        arrives = max(self._hit_tick + round(PUSH_ARRIVES_S * TICK_HZ), plan_tick + LEAST_TICKS)
        told = self._limb_to(view, goal, joint, arrives, PUSH_TEXT, plan_tick)
        return replace(told, hold_ticks=PUSH_HOLD_TICKS)

    def _limb_to(self, view: BodyView, goal: Array, joint: str, lands_tick: int, text: str, plan_tick: int) -> PlanGoal:
        """A joint to a point at a tick, by way of a nearer point if it is far."""
        here = view.pos_w_m[CANONICAL.index(joint)]
        point = stepped_target(here, goal, STEP_M * view.scale)
        whole = float(np.linalg.norm(goal - here))
        share = float(np.linalg.norm(point - here)) / whole if whole > 1e-6 else 1.0
        arrival = plan_tick + max(1, round((lands_tick - plan_tick) * share))
        x, y, z = (float(v) for v in point)
        return PlanGoal(
            text=text,
            targets=(JointTarget(joint=joint, position_w_m=(x, y, z), arrival_tick=arrival),),
            heading=HeadingTarget(heading_rad=atan2(self._way[1], self._way[0]), arrival_tick=arrival),
            guidance=self._spec.guidance,
        )

    def status(self, trace: Trace) -> Status:
        """Done when the bag is down and the limb was first; failed when it is down by anything else."""
        blow = self._judged(trace)
        if trace.world is not None and blow is not None and self._lands_tick is not None:
            limb = trace.world.impulse_ns(self._known().object, object_rules.LIMBS[self._spec.limb])
            self._felt |= bool((limb[max(self._blow_tick - trace.start_tick, 0) :] > 0).any())
        if blow is None or not blow.outcome.code:
            return "running"
        return "done" if blow.outcome.met_tick is not None else "failed"

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
