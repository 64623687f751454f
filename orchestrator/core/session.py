"""One character and its loop, whoever says what it should do: commands, an episode's tasks, an evaluation, a bank.

Whoever drives it brings a goal source, which is asked at every plan, and judges the cycles that come back.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import asdict
from typing import Protocol

import numpy as np

from orchestrator.core.drivers import Cycle, Driver, LockstepDriver, RealtimeDriver
from orchestrator.core.events import EventLog
from orchestrator.core.fanout import Fanout
from orchestrator.core.loop import CharacterLoop, GoalSource
from orchestrator.core.scenes import SceneChoice
from orchestrator.core.services import Services
from orchestrator.core.settings import LOCKSTEP, REALTIME, LoopSettings
from shared.errors import ConflictError, MotionLoopError
from shared.protocol.control import Ok
from shared.protocol.messages import CloseCharacter, CreateCharacter, Pacing, StateFrame
from shared.scenes.clearing import clear_of
from shared.scenes.schema import Scene

ROOM_M = 0.35
"""A body that is put on its feet needs so much room round its pelvis."""


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

    async def start(self) -> StateFrame:
        """Make it at the tracker."""
        choices, scenes = self._choices, self._services.scenes
        self.scene = scenes.chosen(choices.scene, choices.seed)
        request = CreateCharacter(
            character=choices.character,
            scene=scenes.for_tracker(choices.scene, choices.seed),
            tracker=choices.tracker or self._services.tracker.plugin,
            pacing=choices.pacing,
            seed=choices.seed,
            heading_rad=self._heading_rad,
        )
        self._state = await self.loop.ask_tracker(StateFrame, request)
        driver = LockstepDriver if choices.pacing == "lockstep" else RealtimeDriver
        self._driver = driver(self.loop, self._state)
        return self._state

    async def cycle(self, source: GoalSource, max_ticks: int | None = None) -> Cycle:
        """Let it go on for a while under `source`; viewers and events are told. Raises as `Driver.cycle`."""
        if self._driver is None:
            raise ConflictError("the character was not started")
        cycle = await self._driver.cycle(source, max_ticks)
        self.show(cycle.state)
        for plan in cycle.plans:
            self.events.emit("plan", cycle.state.tick, **asdict(plan))
        if (error := self.loop.take_swap_error()) is not None:
            self.events.emit("swap_failed", cycle.state.tick, reason=error)
        return cycle

    def show(self, state: StateFrame) -> None:
        """Take a state that came outside of a cycle, and hand it to the viewers."""
        self._state = state
        self.states.publish(state)

    def replan_now(self) -> None:
        """What is wanted has changed: do not wait for the next regular plan."""
        if self._driver is not None:
            self._driver.replan_now()

    async def reset(self) -> StateFrame:
        """Put it on its feet where it is, or beside what stands there, and plan anew."""
        self._state = await self.loop.reset(self._free_place())
        if self._driver is not None:
            await self._driver.drop_plan()
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
