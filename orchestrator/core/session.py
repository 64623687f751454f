"""One character and its loop, whoever says what it should do: commands, an episode's tasks, an evaluation, a bank.

Whoever drives it brings a goal source, which is asked at every plan, and judges the cycles that come back.
"""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Awaitable, Callable, Iterator
from dataclasses import asdict
from typing import Protocol

import numpy as np

from orchestrator.core.drivers import Cycle, Driver, LockstepDriver, RealtimeDriver
from orchestrator.core.events import EventLog
from orchestrator.core.fanout import Fanout
from orchestrator.core.keepsake import Keepsake
from orchestrator.core.loop import CharacterLoop, GoalSource
from orchestrator.core.scenes import SceneChoice
from orchestrator.core.services import Reply, Services
from orchestrator.core.settings import LOCKSTEP, REALTIME, LoopSettings
from shared.errors import ConflictError, MotionLoopError, NotFoundError, TransportError
from shared.motion.skeleton import CANONICAL
from shared.protocol.base import Message
from shared.protocol.control import Ok
from shared.protocol.messages import (
    CloseCharacter,
    CreateCharacter,
    Pacing,
    SetPacing,
    Snapshot,
    StateFrame,
    TakeSnapshot,
)
from shared.scenes.clearing import clear_of
from shared.scenes.schema import Scene
from shared.tasks.interface import Trace

log = logging.getLogger(__name__)

MOST_AHEAD_TICKS = 1800
"""A character that went on by itself for longer than this is put back to what was kept of it."""

ROOM_M = 0.35
"""A body that is put on its feet needs so much room round its pelvis."""


class PutBackError(TransportError):
    """The tracker was lost while it was asked for something, and the character is now what was kept of it earlier: who
    drives it goes on from there, and asks again when it comes to that."""

    code = "put_back"


class Choices(Protocol):
    """What a session is made with; specs of characters and of episodes have it."""

    @property
    def character(self) -> str:
        """Of the registry."""
        ...

    @property
    def scene(self) -> SceneChoice:
        """By name or inline."""
        ...

    @property
    def planner(self) -> str | None:
        """Plug-in; None for the service's own choice."""
        ...

    @property
    def tracker(self) -> str | None:
        """Plug-in; None for the service's own choice."""
        ...

    @property
    def pacing(self) -> Pacing:
        """By the wall clock, or as fast as it goes."""
        ...

    @property
    def seed(self) -> int:
        """Of everything random."""
        ...

    @property
    def loop(self) -> LoopSettings | None:
        """None for the defaults of the pacing."""
        ...


class Session:
    """A character from its making at the tracker to its end there.

    Args:
        character_id: as the tracker will know it.
        choices: what to make.
        services: planner and tracker.
        events: where to say what happens.
        heading_rad: which way it faces at the start.

    Attributes:
        kept: what it would be brought back from; None where nothing is kept (`Services.rescue_s`).
        lost: why its tracker is being looked for, or None.
        log_from_tick: from when on the tracker has its log.
        on_keep: called with what is about to be kept; where it raises a MotionLoopError the older one stays.
        on_rewind: called with the tick to which the character was put back. Who is called goes back with it, so that
            what was asked for when the tracker was lost is not asked again (PutBackError).
    """

    def __init__(
        self, character_id: str, choices: Choices, services: Services, events: EventLog, heading_rad: float = 0.0
    ):
        settings = choices.loop or (LOCKSTEP if choices.pacing == "lockstep" else REALTIME)
        self.events = events
        self.states: Fanout[StateFrame] = Fanout()
        self.loop = CharacterLoop(character_id, services, settings, choices.seed, choices.planner)
        self.scene: Scene | None = None
        self._choices = choices
        self._services = services
        self._heading_rad = heading_rad
        self._state: StateFrame | None = None
        self._driver: Driver | None = None
        self.kept: Keepsake | None = None
        self.lost: str | None = None
        self.log_from_tick = 0
        self.on_keep: Callable[[Keepsake], Awaitable[None]] | None = None
        self.on_rewind: list[Callable[[int], None]] = []
        self._given_up = False
        self._keep_due = False

    @property
    def created(self) -> bool:
        """Whether the tracker has it."""
        return self._state is not None

    @property
    def state(self) -> StateFrame:
        """The newest state seen; raises ConflictError before `start`."""
        if self._state is None:
            raise ConflictError("the character was not started")
        return self._state

    @property
    def tick(self) -> int:
        """Of the newest state; 0 before `start`."""
        return 0 if self._state is None else self._state.tick

    @property
    def gets_up(self) -> bool:
        """Whether the character's tracker can follow a way up from the floor, as it declares."""
        return bool(self.loop.home.slot.spec(self._choices.tracker).get("gets_up"))

    async def start(self) -> StateFrame:
        """Make it at the tracker."""
        try:
            self._state = await self._made()
        except BaseException:
            self.loop.home.leave()
            raise
        self._driver = self._make_driver(self._state)
        self._keep_due = True
        return self._state

    async def _made(self) -> StateFrame:
        choices, scenes = self._choices, self._services.scenes
        self.choose_scene()
        request = CreateCharacter(
            character=choices.character,
            scene=scenes.for_tracker(choices.scene, choices.seed),
            tracker=choices.tracker or self._services.tracker.plugin,
            pacing=choices.pacing,
            seed=choices.seed,
            heading_rad=self._heading_rad,
        )
        return await self.loop.ask_tracker(StateFrame, request)

    def choose_scene(self) -> Scene | None:
        """The scene as the seed makes it; None where only the tracker knows it."""
        self.scene = self._services.scenes.chosen(self._choices.scene, self._choices.seed)
        return self.scene

    async def take_up(self, kept: Keepsake) -> StateFrame:
        """Go on with a character that an earlier process left at a tracker, or kept, instead of making one.

        By the clock it may have gone on meanwhile, which is no loss while it was not for long.
        """
        self.choose_scene()
        by_clock = self._choices.pacing == "realtime"
        self.loop.home.settle(kept.loop.endpoint)
        try:
            state, rewound = await self.loop.home.find_again(
                kept.snapshot, by_clock, self._services.rescue_s, lambda: self._given_up, MOST_AHEAD_TICKS
            )
        except BaseException:
            self.loop.home.leave()
            raise
        self._state, self.kept = state, kept
        self._driver = self._make_driver(state)
        self.loop.remember(kept.loop, kept.planned_w_m)
        await self._driver.go_on(state, kept.pace, kept.tick)
        if rewound:
            self.log_from_tick = kept.first_logged_tick
        return state

    def _make_driver(self, state: StateFrame) -> Driver:
        if self._choices.pacing == "lockstep":
            return LockstepDriver(self.loop, state)
        return RealtimeDriver(self.loop, state, self._services.lead)

    async def ask(self, kind: type[Reply], message: Message) -> Reply:
        """The tracker's reply; where the tracker is lost, the reply of the one that the character was brought back at.

        Raises as `CharacterLoop.ask_tracker`, and PutBackError.
        """
        try:
            return await self.loop.ask_tracker(kind, message)
        except (TransportError, NotFoundError) as error:
            await self._come_back_to_ask(error)
            return await self.loop.ask_tracker(kind, message)

    async def cycle(self, source: GoalSource, max_ticks: int | None = None) -> Cycle:
        """Let it go on for a while under `source`; viewers and events are told.

        Where its tracker is lost, the cycle is the one that brings it back. Raises as `Driver.cycle`.
        """
        if self._driver is None:
            raise ConflictError("the character was not started")
        try:
            cycle = await self._driver.cycle(source, max_ticks)
        except (TransportError, NotFoundError) as error:
            cycle = await self._come_back(error)
        self.show(cycle.state)
        self._keep_due = self._keep_due or any(plan.accepted for plan in cycle.plans)
        for plan in cycle.plans:
            self.events.emit("plan", cycle.state.tick, **asdict(plan))
        if (failed := self.loop.home.take_swap_error()) is not None:
            self.events.emit("swap_failed", cycle.state.tick, reason=failed)
        return cycle

    def show(self, state: StateFrame) -> None:
        """Take a state that came outside of a cycle, also for the next plan, and hand it to the viewers."""
        self._state = state
        if self._driver is not None:
            self._driver.saw(state)
        self.states.publish(state)

    def replan_now(self) -> None:
        """What is wanted has changed: do not wait for the next regular plan."""
        if self._driver is not None:
            self._driver.replan_now()

    def keep_soon(self) -> None:
        """Let the next `keep_if_due` keep it."""
        self._keep_due = True

    async def keep_if_due(self, last: bool = False) -> None:
        """`keep`, once after each plan; called when all that a cycle has shown was acted on."""
        if self._keep_due:
            await self.keep(last)

    async def keep(self, last: bool = False) -> None:
        """Keep what it can be brought back from. What cannot be had now is had later: the older one stays.

        Args:
            last: there is no later: where the tracker is lost, the character is brought back.

        Raises PutBackError where it is `last`, or what was raised by a tracker that stays lost.
        """
        self._keep_due = False
        driver = self._driver
        if driver is None or (self._services.rescue_s <= 0 and self.on_keep is None):
            return
        try:
            await self._keep(driver)
        except (TransportError, NotFoundError) as error:
            if last:
                await self._come_back_to_ask(error)
                await self._keep(driver)
        except MotionLoopError as error:
            log.info("nothing is kept of character %s at tick %d: %s", self.loop.character_id, self.tick, error)

    async def _keep(self, driver: Driver) -> None:
        snapshot = await self.loop.ask_tracker(Snapshot, TakeSnapshot())
        known, planned_w_m = self.loop.remembered()
        kept = Keepsake(snapshot, known, driver.pace(), planned_w_m)
        if self.on_keep is not None:
            await self.on_keep(kept)
        self.kept = kept

    def give_up(self) -> None:
        """Do not look for a tracker that was lost any more."""
        self._given_up = True

    async def _come_back_to_ask(self, error: MotionLoopError) -> None:
        """`_come_back`; raises PutBackError where what failed is not to be asked again."""
        cycle = await self._come_back(error)
        if cycle.put_back and self.on_rewind:
            raise PutBackError(f"the character was put back to tick {cycle.state.tick}: {error.message}") from error

    async def _come_back(self, error: MotionLoopError) -> Cycle:
        """Look for the character, or bring it back from what was kept; raises `error` where that cannot be done."""
        kept, driver, before = self.kept, self._driver, self.state
        if kept is None or driver is None or self._services.rescue_s <= 0:
            raise error
        began_s, self.lost = time.monotonic(), error.message
        self.events.emit("tracker_lost", self.tick, reason=error.message)
        try:
            state, rewound = await self.loop.home.find_again(
                kept.snapshot, driver.by_clock, self._services.rescue_s, lambda: self._given_up
            )
            if before.paused and not state.paused:
                state = await self.loop.ask_tracker(StateFrame, SetPacing(pacing=state.pacing, paused=True))
        except MotionLoopError as last:
            raise error from last
        finally:
            self.lost = None
        if rewound:
            self.loop.remember(kept.loop, kept.planned_w_m)
            await driver.go_on(state, kept.pace, state.tick)
            self.log_from_tick = max(self.log_from_tick, kept.first_logged_tick)
            for call in self.on_rewind:
                call(state.tick)
        self._state = state
        self.events.emit(
            "tracker_back",
            state.tick,
            endpoint=self.loop.home.slot.endpoint,
            lost_ticks=max(before.tick - state.tick, 0),
            seconds=round(time.monotonic() - began_s, 3),
        )
        nothing = Trace(state.tick + 1, np.zeros((0, len(CANONICAL), 3)), np.zeros(0, dtype=bool))
        return Cycle(state, nothing, put_back=rewound)

    async def reset(self) -> StateFrame:
        """Put it on its feet where it is, or beside what stands there, and plan anew. Raises PutBackError, as `ask`."""
        try:
            self._state = await self.loop.reset(self._free_place())
        except (TransportError, NotFoundError) as error:
            await self._come_back_to_ask(error)
            self._state = await self.loop.reset(self._free_place())
        if self._driver is not None:
            self._driver.saw(self._state)
            await self._driver.drop_plan()
        self._keep_due = True
        self.events.emit("reset", self._state.tick)
        return self._state

    def _free_place(self) -> tuple[float, float] | None:
        """Beside the object that it lies on, since a reset puts objects back too; None where nothing is in the way."""
        if self.scene is None or self._state is None:
            return None
        here = self._state.body_pos_w_m[0, :2]
        x, y = (float(v) for v in clear_of(self.scene, here, ROOM_M))
        return None if float(np.hypot(x - here[0], y - here[1])) < 1e-6 else (x, y)

    @contextlib.contextmanager
    def in_lockstep(self, start: StateFrame) -> Iterator[None]:
        """Within it cycles advance the tracker as far as they are told, from `start` on; for a clock that is paused."""
        held, self._driver, self._state = self._driver, LockstepDriver(self.loop, start), start
        try:
            yield
        finally:
            self._driver = held

    async def stop(self) -> None:
        """Give up the plan under way; the character stays at the tracker."""
        if self._driver is not None:
            await self._driver.close()

    async def close(self) -> None:
        """End it, at the tracker too (which may be gone already)."""
        await self.stop()
        with contextlib.suppress(MotionLoopError):
            await self.loop.ask_tracker(Ok, CloseCharacter())
