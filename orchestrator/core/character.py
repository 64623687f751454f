"""A character that follows commands until told otherwise (no tasks, no end)."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from typing import Literal

from pydantic import BaseModel, ConfigDict

from orchestrator.core.command import STAND, Command
from orchestrator.core.drivers import Cycle
from orchestrator.core.events import EventLog
from orchestrator.core.fanout import Fanout
from orchestrator.core.loop import CharacterLoop, view_of
from orchestrator.core.on_fall import Down, OnFall, get_up_goal
from orchestrator.core.own_world import as_planned
from orchestrator.core.reading import NearestSentences, read_command
from orchestrator.core.scenes import SceneChoice, name_of
from orchestrator.core.services import Services
from orchestrator.core.session import Session
from orchestrator.core.settings import LoopSettings
from orchestrator.core.steps import SteppedGoal
from orchestrator.rest import CommandReading
from shared.errors import ConflictError, InvalidInputError, MotionLoopError, NotFoundError, TransportError
from shared.motion.skeleton import CANONICAL
from shared.protocol.base import Name
from shared.protocol.control import Ok
from shared.protocol.messages import (
    Impulse,
    Pacing,
    Seed,
    SetObject,
    SetPacing,
    StateFrame,
    Vec3,
)
from shared.scenes.schema import Scene
from shared.tasks.interface import BodyView, PlanGoal
from shared.tracing import current_trace

log = logging.getLogger(__name__)

Status = Literal["running", "paused", "degraded", "failed", "closed"]

REFUSALS_IN_A_ROW = 4
"""A planner that fails more often than this, one plan after the other, has failed for good."""


class CharacterSpec(BaseModel):
    """A character to make. planner and tracker name plug-ins; None for the services' own choice.

    After a fall it stays where it is, is put on its feet, or gets up; then its command goes on.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")
    character: Name = "human"
    scene: SceneChoice = "flat"
    planner: Name | None = None
    tracker: Name | None = None
    pacing: Pacing = "realtime"
    seed: Seed = 0
    loop: LoopSettings | None = None
    on_fall: OnFall = "get_up"


class CharacterSession:
    """One commanded character: realtime ones run by themselves, lockstep ones when `advance` is called."""

    def __init__(self, character_id: str, spec: CharacterSpec, services: Services, events: EventLog):
        self.character_id = character_id
        self.spec = spec
        self.events = events
        self._status: Status = "running"
        self.reason: str | None = None
        self._services = services
        self._session = Session(character_id, spec, services, events)
        self._source = SteppedGoal(STAND, 0)
        self._nearest = NearestSentences()
        self._runner: asyncio.Task[None] | None = None
        self._lock = asyncio.Lock()
        self._refusals = 0
        self._down = Down()
        self._was_down = False

    @property
    def status(self) -> Status:
        """`degraded` also while its tracker is looked for."""
        return "degraded" if self._status == "running" and self._session.lost is not None else self._status

    @property
    def state(self) -> StateFrame:
        """The newest state seen; raises ConflictError before `start`."""
        return self._session.state

    @property
    def states(self) -> Fanout[StateFrame]:
        """For viewers."""
        return self._session.states

    @property
    def loop(self) -> CharacterLoop:
        """Its plans and its tracker."""
        return self._session.loop

    @property
    def scene(self) -> Scene | None:
        """As its seed made it; None where only the tracker knows it."""
        return self._session.scene

    @property
    def command(self) -> Command:
        """The command in force."""
        return self._source.command

    async def start(self) -> StateFrame:
        """Make it at the tracker and, in realtime, let it run."""
        state = await self._session.start()
        if self.spec.pacing == "realtime":
            self._run_on()
        await self._session.keep_if_due()
        self.events.emit("created", state.tick, scene=name_of(self.spec.scene), pacing=self.spec.pacing)
        return state

    def _goal(self, view: BodyView, plan_tick: int) -> PlanGoal:
        """What the newest command asks for: it may have come while a cycle was already under way."""
        if self._on_fall == "get_up" and self._down.update(view):
            return get_up_goal()
        return self._source(as_planned(view, self.loop.planned), plan_tick)

    @property
    def _on_fall(self) -> OnFall:
        """As it was made, but nobody is told to get up who cannot."""
        wanted = self.spec.on_fall
        return "reset" if wanted == "get_up" and not self._session.gets_up else wanted

    def set_command(self, command: Command) -> int:
        """Take a new command; returns the tick at which it was given. Raises for a target out of reach."""
        self._check_alive()
        command.check_reachable(view_of(self.state))
        if command != self.command or command.keyframes:  # repeated, it goes on: what counts down must not start anew
            self._source = SteppedGoal(command, self.state.tick)
        if command.replan == "now":
            self._session.replan_now()
        self.loop.trace_id = current_trace()
        self.events.emit("command", self.state.tick, **command.model_dump(mode="json", exclude_none=True))
        return self.state.tick

    async def reading(self, command: Command) -> CommandReading:
        """How a command is taken by the planner in use; what is noteworthy of it becomes an event too."""
        source = SteppedGoal(command, self.state.tick)
        spec = self.loop.planner_spec()
        reading = read_command(command, source.wording, spec)
        if reading.understood is not None and "text" in spec.conditions:
            found = [await self._nearest.of(self._services.planner, spec.name, step) for step in reading.steps]
            far = sorted((near for near in found if near is not None), key=lambda near: near.similarity)
            reading = reading.model_copy(update={"nearest": far[0] if far else None})
        if reading.noteworthy:
            self.events.emit("understood", self.state.tick, text=command.text, **reading.model_dump(mode="json"))
        return reading

    async def advance(self, ticks: int) -> StateFrame:
        """Let a lockstep character, or a realtime one that is paused, go on for `ticks`."""
        self._check_alive()
        if self.spec.pacing == "realtime":
            return await self._advance_paused(ticks)
        async with self._lock:
            await self._until(self.state.tick + ticks)
        return self.state

    async def _until(self, tick: int) -> None:
        while self.state.tick < tick:
            await self._cycle(tick - self.state.tick)

    async def _advance_paused(self, ticks: int) -> StateFrame:
        """Lockstep for a moment: the same loop, so that its plans follow those made by the clock."""
        async with self._lock:
            if self.status != "paused":
                raise ConflictError(
                    "a realtime character is stepped while it is paused", field="pacing", allowed="lockstep, or paused"
                )
            start = await self.loop.ask_tracker(StateFrame, SetPacing(pacing="lockstep", paused=True))
            try:
                with self._session.in_lockstep(start):
                    await self._until(start.tick + ticks)
            finally:
                held = SetPacing(pacing="realtime", paused=True)
                self._session.show(await self.loop.ask_tracker(StateFrame, held))
            self.events.emit("stepped", self.state.tick, ticks=ticks)
        return self.state

    async def impulse(self, body: str, impulse_w_ns: Vec3) -> None:
        """Push a body."""
        self._check_alive()
        if body not in CANONICAL.names:
            raise InvalidInputError(f"unknown body {body!r}", field="body", allowed=", ".join(CANONICAL.names))
        await self.loop.ask_tracker(Ok, Impulse(body=body, impulse_w_ns=impulse_w_ns))
        self.events.emit("impulse", self.state.tick, body=body, impulse_ns=list(impulse_w_ns))

    async def set_object(self, message: SetObject) -> StateFrame:
        """Put an object of the scene somewhere, at once; raises InvalidInputError for one that cannot move so."""
        self._check_alive()
        async with self._lock:
            self._session.show(await self.loop.ask_tracker(StateFrame, message))
        self.events.emit("object", self.state.tick, **message.model_dump(mode="json", exclude_none=True))
        return self.state

    async def reset(self) -> StateFrame:
        """Stand it up where it is; the command becomes standing. One that has failed runs again."""
        self._check_alive(even_failed=True)
        async with self._lock:
            state = await self._session.reset()
            self._source = SteppedGoal(STAND, state.tick)
        if self.status == "failed":
            self._status, self.reason, self._refusals = "running", None, 0
            if self.spec.pacing == "realtime":
                self._run_on()
        return self.state

    async def pause(self, paused: bool) -> StateFrame:
        """Stop or restart a realtime clock."""
        self._check_alive()
        if self.spec.pacing != "realtime":
            raise ConflictError("only a realtime character can be paused", field="pacing", allowed="realtime")
        self._session.show(await self.loop.ask_tracker(StateFrame, SetPacing(pacing="realtime", paused=paused)))
        self._status = "paused" if paused else "running"
        self.events.emit("paused" if paused else "resumed", self.state.tick)
        return self.state

    async def close(self) -> None:
        """End it, at the tracker too (which may be gone already)."""
        if self.status == "closed":
            return
        self._status = "closed"
        self._session.give_up()
        if self._runner is not None:
            self._runner.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._runner
        await self._session.close()
        self.events.emit("closed", self._session.tick)
        self.events.close()
        self.states.close()

    def _check_alive(self, even_failed: bool = False) -> None:
        if self.status == "closed" or (self.status == "failed" and not even_failed):
            raise ConflictError(f"the character is {self.status}: {self.reason or 'deleted'}", field="status")

    def _run_on(self) -> None:
        self._runner = asyncio.create_task(self._run(), name=f"character-{self.character_id}")

    async def _run(self) -> None:
        while self.status not in ("failed", "closed"):
            async with self._lock:
                with contextlib.suppress(MotionLoopError):  # noted by _cycle in `status` and `reason`
                    await self._cycle(None)

    async def _cycle(self, max_ticks: int | None) -> None:
        """One cycle. Whatever it raises ends as a MotionLoopError that `status`, `reason` and the events tell of."""
        was_fallen = self.state.fallen
        try:
            cycle = await self._session.cycle(self._goal, max_ticks)
        except (TransportError, NotFoundError) as error:
            self._fail(f"the tracker is gone: {error.message}")
            raise
        except MotionLoopError as error:
            self._refused(error)
            raise
        except Exception as error:
            log.exception("character %s broke", self.character_id)
            self._fail(f"internal: {type(error).__name__}: {error}")
            raise MotionLoopError(str(self.reason)) from error
        self._refusals = 0 if cycle.plans else self._refusals
        self._take(cycle, was_fallen)
        await self._after_fall(cycle.state)
        await self._session.keep_if_due()

    async def _after_fall(self, state: StateFrame) -> None:
        """See that a character goes on after a fall, as it was made to."""
        was = self._was_down
        self._was_down = down = self._down.update(view_of(state))
        fell = down and not was
        on_fall = self._on_fall
        if (fell and on_fall == "reset") or (on_fall == "get_up" and self._down.too_long(state.tick)):
            await self._session.reset()
            self._down.clear()
            self._was_down = False
        elif down != was and on_fall == "get_up":
            self._session.replan_now()
            self.events.emit("getting_up" if fell else "stood_up", state.tick)

    def _refused(self, error: MotionLoopError) -> None:
        """The planner would not, or could not, plan: stand instead. One that cannot even plan that has failed."""
        self.events.emit("plan_refused", self.state.tick, code=error.code, message=error.message, field=error.field)
        self._refusals += 1
        if self._refusals > REFUSALS_IN_A_ROW:
            self._fail(f"the planner fails: {error.message}")
            return
        self._source = SteppedGoal(STAND, self.state.tick)
        self._session.replan_now()

    def _take(self, cycle: Cycle, was_fallen: bool) -> None:
        if cycle.state.fallen and not was_fallen:
            self.events.emit("fallen", cycle.state.tick)
        if cycle.state.failure is not None:
            self.events.emit("physics_failed", cycle.state.tick, reason=cycle.state.failure)
        if cycle.planner_error is not None and self._status == "running":
            self._status, self.reason = "degraded", cycle.planner_error
            self.events.emit("degraded", cycle.state.tick, reason=cycle.planner_error)
        elif cycle.planner_error is None and self._status == "degraded":
            self._status, self.reason = "running", None
            self.events.emit("recovered", cycle.state.tick)

    def _fail(self, reason: str) -> None:
        self._status, self.reason = "failed", reason
        if self._session.created:
            self._session.show(self.state.model_copy())  # once more, with the status that it has now
        self.events.emit("failed", self._session.tick, reason=reason)
