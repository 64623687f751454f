"""The loop of one character: simulated prefix -> plan -> tracker (CLoSD's loop, DESIGN 6)."""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from orchestrator.core.asking import keyframe_arrays, obstacle_arrays
from orchestrator.core.chain import chained, following
from orchestrator.core.home import Home
from orchestrator.core.keepsake import LoopState
from orchestrator.core.own_world import KEPT_FRAMES, Planned, planned_at, planned_prefix
from orchestrator.core.services import Reply, Services
from orchestrator.core.settings import LoopSettings
from orchestrator.core.stitch import PlanBuffer, build_prefix, log_window, since
from shared.errors import InvalidInputError, MalformedMessageError, UnavailableError
from shared.motion.characters import build
from shared.motion.ik import clip_from_positions
from shared.motion.skeleton import CANONICAL
from shared.plugins.checks import planner_spec
from shared.plugins.interfaces import PlannerSpec
from shared.protocol.base import Message
from shared.protocol.messages import (
    PLANNER_FPS,
    TICK_HZ,
    GetTicks,
    Look,
    Observe,
    Plan,
    PlanRequest,
    ResetCharacter,
    StateFrame,
    Step,
    TickRange,
    Track,
    TrackReply,
)
from shared.protocol.rates import first_start_by, frame_of_tick, start_spacing
from shared.tasks.interface import BodyView, PlanGoal, Trace, joined
from shared.tasks.obey import asks_low, holds_ticks
from shared.tasks.world import World
from shared.tracing import traced

GoalSource = Callable[[BodyView, int], PlanGoal]
"""What to ask for, given the body now and the tick the plan will start at."""

MAX_TRACE_TICKS = 900
LEAST_PLAN_FRAMES = 4


def plan_seed(seed: int, index: int) -> int:
    """Seed of the index-th plan of an episode: the same everywhere, unrelated between plans."""
    return int.from_bytes(hashlib.sha256(f"{seed}:{index}".encode()).digest()[:8], "little") >> 1


@dataclass(frozen=True)
class PlanTiming:
    """One plan as it came: for events and measurements.

    Attributes:
        index: counts the character's plans. start_tick, accepted, entered_tick, reason: what the tracker made of it.
        total_ms: from the request to the tracker's reply. parts_ms: what the planner says of its share.
        text: as asked for; understood, nearest, ignored, guidance: as in the plan.
    """

    index: int
    start_tick: int
    accepted: bool
    entered_tick: int | None
    total_ms: float
    text: str | None
    reason: str | None = None
    ignored: tuple[str, ...] = ()
    understood: str | None = None
    nearest: str | None = None
    guidance: float | None = None
    parts_ms: dict[str, float] = field(default_factory=dict)


def timing_of(plan: Plan, index: int, reply: TrackReply, total_ms: float, text: str | None) -> PlanTiming:
    """What is told of a plan that the tracker has answered."""
    return PlanTiming(
        index,
        plan.start_tick,
        reply.accepted,
        reply.entered_tick,
        total_ms,
        text,
        reply.reason,
        tuple(plan.ignored_conditions),
        plan.understood,
        plan.nearest,
        plan.guidance,
        {name: round(ms, 3) for name, ms in plan.timings_ms.items()},
    )


def view_of(state: StateFrame) -> BodyView:
    """The body in a state frame."""
    character = build(state.character)
    poses = np.concatenate([state.object_pos_w_m, state.object_quat_w], axis=-1).astype(np.float64)
    objects = dict(zip(state.objects, poses, strict=True))
    positions = np.asarray(state.body_pos_w_m, dtype=np.float64)
    return BodyView(state.tick, positions, state.fallen, character.world_scale, objects, character.mass_kg)


def trace_of(ticks: TickRange) -> Trace:
    """A range of the log at 30 Hz as tasks see it."""
    return trace_from(ticks.start_tick, vars(ticks), ticks.objects)


def trace_from(start_tick: int, arrays: Mapping[str, Any], objects: Sequence[str]) -> Trace:
    """The same from the arrays of a `TickRange`, by name."""
    world = World(
        tuple(objects),
        np.asarray(arrays["object_pose_w"], dtype=np.float64),
        np.asarray(arrays["object_vel_w"], dtype=np.float64),
        np.asarray(arrays["contact_sample"]),
        np.asarray(arrays["contact_body"]),
        np.asarray(arrays["contact_object"]),
        np.asarray(arrays["contact_impulse_ns"], dtype=np.float64),
    )
    positions, fallen = np.asarray(arrays["body_pos_w_m"], dtype=np.float64), np.asarray(arrays["fallen"], dtype=bool)
    return Trace(start_tick, positions, fallen, world)


class CharacterLoop:
    """Requests, joins and delivers the plans of one character.

    Plans are made for the canonical skeleton: what goes to the planner (prefix, goal) is brought to its world, and the
    plan that comes back to the character's (`shared.motion.characters`). Here everything is in the character's.

    Args:
        character_id: as the tracker knows it.
        services: where planner and tracker are.
        settings: how plans are requested.
        seed: of the episode; every plan's seed comes from it and the plan's index.
        planner: plug-in to ask for, None for the slot's.
    """

    def __init__(
        self, character_id: str, services: Services, settings: LoopSettings, seed: int, planner: str | None = None
    ):
        self.character_id = character_id
        self.settings = settings
        self.planner = planner
        self._services = services
        self.home = Home(character_id, services, settings.tracker_timeout_s)
        self._planner_slot = services.planner
        self._seed = seed
        self._buffer = PlanBuffer()
        self._since_tick = 0
        self._build = build("human")
        self._may_be_low = (-1, False)
        self.plans_made = 0
        self.on_plan: list[Callable[[Plan], None]] = []  # called with each plan that the tracker has accepted
        self.trace_id: str | None = None
        """Of the newest command's request: goes along with the plans made for it."""
        self.last_plan: Plan | None = None
        self.has_plan = False  # whether the tracker follows a plan of ours

    async def reset(self, position_w_m: tuple[float, float] | None = None) -> StateFrame:
        """Stand the character up, where it is or at a place. What was planned and done before says nothing about it any
        more."""
        state = await self.ask_tracker(StateFrame, ResetCharacter(position_w_m=position_w_m))
        self._buffer.clear()
        self.last_plan, self.has_plan = None, False
        self._since_tick = state.tick
        return state

    @property
    def planned(self) -> Planned | None:
        """What an open loop takes the body to have done; None in a closed loop, which looks."""
        open_loop = self.settings.mode == "open_loop"
        return (lambda start, stop: planned_at(self._buffer, start, stop)) if open_loop else None

    def remembered(self) -> tuple[LoopState, npt.NDArray[np.float64]]:
        """What it knows and what is planned, for `remember`."""
        buffer = self._buffer
        known = LoopState(
            endpoint=self.home.slot.endpoint,
            planner=self.planner,
            plans_made=self.plans_made,
            since_tick=self._since_tick,
            may_be_low=self._may_be_low,
            has_plan=self.has_plan,
            fps=buffer.fps,
            first_frame=buffer.first_frame,
        )
        return known, buffer.held()

    def remember(self, known: LoopState, planned_w_m: npt.NDArray[np.float64]) -> None:
        """Go on as the loop was: the character was put back to that moment."""
        self.planner, self.plans_made = known.planner, known.plans_made
        self._since_tick, self._may_be_low, self.has_plan = known.since_tick, known.may_be_low, known.has_plan
        self._buffer = PlanBuffer(known.fps)
        if len(planned_w_m):
            self._buffer.put(known.first_frame, planned_w_m)

    async def ask_tracker(self, kind: type[Reply], message: Message, timeout_s: float | None = None) -> Reply:
        """The reply of the tracker that the character lives at, by default within the tracker's time-out."""
        reply = await self.home.ask(kind, message, timeout_s)
        if isinstance(reply, StateFrame):
            self._build = build(reply.character)
        return reply

    async def observe(self) -> StateFrame:
        """The present state."""
        return await self.ask_tracker(StateFrame, Observe())

    async def look(self, since_tick: int) -> tuple[StateFrame, Trace]:
        """The present state and what happened at the ticks since_tick.., in one question to the tracker."""
        seen = await self.ask_tracker(Look, Observe(since_tick=since_tick))
        new = trace_of(seen)
        if seen.start_tick > since_tick:
            new = joined((await self.trace(since_tick, seen.start_tick), new))
        # Where nothing is new the present tick is there all the same.
        return seen.state(), new.since(since_tick)

    async def step(self, ticks: int) -> StateFrame:
        """Advance a lockstep character."""
        return await self.ask_tracker(StateFrame, Step(ticks=ticks))

    async def trace(self, start_tick: int, stop_tick: int) -> Trace:
        """The log at 30 Hz, ticks start..stop-1."""
        parts = [
            trace_of(await self.ticks(begin, min(begin + MAX_TRACE_TICKS, stop_tick), TICK_HZ))
            for begin in range(start_tick, stop_tick, MAX_TRACE_TICKS)
        ]
        return joined(parts) if parts else Trace(start_tick, np.zeros((0, len(CANONICAL), 3)), np.zeros(0, dtype=bool))

    async def ticks(self, start_tick: int, stop_tick: int, rate_hz: int, reference: bool = False) -> TickRange:
        """A range of the tracker's log (at most 4096 samples)."""
        asked = {"start_tick": start_tick, "stop_tick": stop_tick, "rate_hz": rate_hz, "include_reference": reference}
        return await self.ask_tracker(TickRange, GetTicks.model_validate(asked))

    async def make_plan(self, goal: PlanGoal, now_tick: int, start_tick: int) -> Plan:
        """Ask the planner for the motion from `start_tick` on; the character is at `now_tick` <= start_tick.

        The prefix is what was simulated up to now and then the rest of the old plan (DESIGN 6).
        """
        spec = self.planner_spec(goal.planner)
        request = await self._request(spec, goal, now_tick, start_tick)
        try:
            with traced(self.trace_id):
                plan = part = await self._best(request, goal)
                for _ in range(self.settings.chained_plans - 1):
                    request = following(request, part, plan_seed(request.seed, 1))
                    part = await self._planned(request)
                    plan = chained(plan, part)
        except InvalidInputError as error:
            if self.planner_spec(goal.planner) == spec:
                raise
            raise UnavailableError(f"the planner has become another one: {error.message}") from error
        self.plans_made += 1
        low = goal.may_be_low
        self._may_be_low = (start_tick, asks_low(plan.understood or goal.text) if low is None else low)
        if self._build.skeleton_id == plan.skeleton:
            return plan
        own = self._build.from_canonical(plan.positions_w_m)
        return plan.model_copy(update={"positions_w_m": own.astype("<f4"), "skeleton": self._build.skeleton_id})

    async def _best(self, request: PlanRequest, goal: PlanGoal) -> Plan:
        """The plan for a request, or of several with other seeds the one that the goal finds best."""
        worth = goal.worth
        if worth is None or goal.candidates < 2:
            return await self._planned(request)
        seeds = [request.seed, *(plan_seed(request.seed, number) for number in range(1, goal.candidates))]
        plans = await asyncio.gather(*(self._planned(request.model_copy(update={"seed": seed})) for seed in seeds))
        return max(plans, key=lambda plan: worth(self._build.from_canonical(plan.positions_w_m), plan.fps))

    async def _planned(self, request: PlanRequest) -> Plan:
        plan = await self._services.planner.ask(Plan, request, self.character_id, self.settings.plan_timeout_s)
        frames = len(np.asarray(plan.positions_w_m))
        if plan.start_tick != request.start_tick or plan.fps != request.fps or frames < 1:
            raise MalformedMessageError(
                f"a plan of {frames} frames at {plan.fps} fps from tick {plan.start_tick} came",
                field="start_tick",
                allowed=f"at least one frame at {request.fps} fps from tick {request.start_tick}",
            )
        return plan

    async def track(self, plan: Plan) -> TrackReply:
        """Hand a plan to the tracker; an accepted one enters the buffer, the old one ends where it starts."""
        await self.home.follow_swaps()
        track = Track(
            start_tick=plan.start_tick,
            fps=plan.fps,
            skeleton=plan.skeleton,
            positions_w_m=plan.positions_w_m,
            rotations_6d=plan.rotations_6d,
            actions=plan.actions,
            action_space=plan.action_space,
            may_be_low=self._may_be_low == (plan.start_tick, True),
        )
        with traced(self.trace_id):
            reply = await self.ask_tracker(TrackReply, track)
        if reply.accepted:
            self._buffer = self._buffer.at_rate(plan.fps)
            first = frame_of_tick(plan.start_tick, plan.fps) + 1
            self._buffer.put(first, plan.positions_w_m, KEPT_FRAMES[self.settings.mode])
            self.last_plan, self.has_plan = plan, True
            for heard in self.on_plan:
                heard(plan)
        return reply

    async def _request(self, spec: PlannerSpec, goal: PlanGoal, now_tick: int, start_tick: int) -> PlanRequest:
        self._buffer = self._buffer.at_rate(spec.fps)
        window = log_window(now_tick, spec.prefix_frames, spec.fps)
        now_frame = window.last_frame
        log = await self.ticks(window.start_tick, window.stop_tick, spec.fps)
        since_frame = frame_of_tick(first_start_by(self._since_tick, spec.fps), spec.fps)
        simulated, velocities = since(
            window.rows(log.body_pos_w_m), window.rows(log.body_linvel_w_mps), now_frame, since_frame
        )
        if self.settings.mode == "open_loop":
            simulated, velocities = planned_prefix(self._buffer, simulated, velocities, now_frame)
        prefix = build_prefix(
            simulated, velocities, now_frame, frame_of_tick(start_tick, spec.fps), self._buffer, spec.prefix_frames,
            self.settings.error_decay_s,
        )  # fmt: skip
        positions = self._build.to_canonical(prefix.positions_w_m)
        clip = clip_from_positions(positions, spec.fps)
        goal = goal.scaled(1.0 / self._build.world_scale)
        guidance = goal.guidance if goal.guidance is not None else self.settings.guidance
        return PlanRequest.model_validate(
            {
                "planner": spec.name,
                "start_tick": start_tick,
                "fps": spec.fps,
                "prefix_positions_w_m": positions,
                "prefix_rotations_6d": clip.rotations_6d,
                "prefix_velocities_w_mps": self._build.to_canonical(prefix.velocities_w_mps),
                "context_frames": prefix.context_frames,
                "text": goal.text,
                "targets": list(goal.targets),
                "heading": goal.heading,
                "desired_velocity_w_mps": goal.desired_velocity_w_mps,
                "facing_rad": goal.facing_rad,
                "guidance": guidance,
                "horizon_frames": self._horizon_frames(spec),
                "seed": plan_seed(self._seed, self.plans_made),
                **keyframe_arrays(goal),
                **obstacle_arrays(goal),
            }
        )

    def planner_spec(self, wanted: str | None = None) -> PlannerSpec:
        """What the planner that the next plan comes from has declared.

        Args:
            wanted: plug-in that a goal asks for; it is taken where the service has it at the rate of the character's
                own planner, so that its plans start at the same ticks.

        Raises InvalidInputError for a plug-in that the service does not have.
        """
        slot = self._services.planner
        if slot is not self._planner_slot:
            # A swap is for everyone: a plug-in that this character asked for by name was one of the old service's.
            self._planner_slot, self.planner = slot, None
        declared = slot.spec(self.planner)
        if not declared:
            raise InvalidInputError(
                f"no planner {self.planner or slot.plugin_name!r}",
                field="planner",
                allowed=", ".join(str(plugin.get("name")) for plugin in slot.present.plugins),
            )
        own = planner_spec(declared)
        other = slot.spec(wanted) if wanted is not None else None
        if other:
            special = planner_spec(other)
            return special if special.fps == own.fps else own
        return own

    def start_spacing(self) -> int:
        """Ticks from one possible start of a plan to the next."""
        return start_spacing(self.planner_spec().fps)

    def period_ticks(self, goal: PlanGoal, plan: Plan | None = None) -> int:
        """Ticks until the plan after one for this goal: the planner's own period, else the settings', and in any case
        before the plan is over. A multiple of `start_spacing`. With the plan, what its text was taken for counts."""
        spec = self.planner_spec(goal.planner)
        wanted = self.settings.period_ticks(bool(goal.targets), goal.replan_ticks)
        wanted = max(wanted, goal.hold_ticks, holds_ticks((plan and plan.understood) or goal.text, goal.targets))
        if spec.replan_frames is not None:
            wanted = spec.replan_frames * TICK_HZ // spec.fps
        spacing = start_spacing(spec.fps)
        lasts = self._horizon_frames(spec) * self.settings.chained_plans * TICK_HZ // spec.fps
        return max(min(wanted, lasts) // spacing, 1) * spacing

    def _horizon_frames(self, spec: PlannerSpec) -> int:
        """Frames to ask for: as long as the settings or the planner's own period say, and at most what it can."""
        wanted = round(self.settings.horizon_frames * spec.fps / PLANNER_FPS)
        return min(max(wanted, spec.replan_frames or 0, LEAST_PLAN_FRAMES), spec.plan_frames)
