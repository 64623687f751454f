"""Where a character lives: the tracker that hosts it, going over to another, and coming back when one is lost."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable

from orchestrator.core.services import Reply, Services, Slot
from shared.errors import MotionLoopError, NotFoundError, OverloadedError
from shared.protocol.base import Message
from shared.protocol.control import Health, HealthReport, Ok
from shared.protocol.messages import (
    CloseCharacter,
    CreateCharacter,
    Observe,
    Restore,
    SetTracker,
    Snapshot,
    StateFrame,
    TakeSnapshot,
)

PATIENCE_S, HEALTH_S = 1.0, 2.5
"""So a tracker that is gone is noticed early, where characters can be brought back: a false alarm costs little then."""
ALIVE_S, MOST_ALIVE_S, PATIENCE_GROWS = 0.5, 8.0, 1.3
"""While a tracker is looked for, one that does not say within this that it is there is looked at again later. Each time
it gets more of it, since on a machine under load a tracker that is there may be slow to say so."""
TRY_AGAIN_S = 0.1
BUSY_S = 0.05


def restore_of(kept: Snapshot) -> Restore:
    """The message that makes a snapshot a character again."""
    return Restore(tick=kept.tick, meta=kept.meta, state=kept.state, buffers=kept.buffers)


class Home:
    """The tracker that a character lives at.

    Args:
        character_id: as the tracker knows it.
        services: where trackers are; the least loaded takes the character in.
        timeout_s: deadline of one request.
    """

    def __init__(self, character_id: str, services: Services, timeout_s: float):
        self._character_id = character_id
        self._services = services
        self._timeout_s = timeout_s
        self._slot = services.place()
        self._followed = services.tracker
        self._swap_error: str | None = None
        services.residents[character_id] = self._slot

    @property
    def slot(self) -> Slot:
        """The tracker."""
        return self._slot

    def settle(self, endpoint: str) -> None:
        """Live at the tracker that has this endpoint, if there is one."""
        for slot in (self._services.tracker, *self._services.spares):
            if slot.endpoint == endpoint:
                self._move_to(slot)
                return

    def leave(self) -> None:
        """It is not there, or not any more: it counts no longer where characters are placed."""
        self._services.residents.pop(self._character_id, None)

    async def ask(self, kind: type[Reply], message: Message, timeout_s: float | None = None) -> Reply:
        """The tracker's reply; one that has no room for a request at the moment is asked again until the deadline."""
        until = time.monotonic() + (timeout_s or self._timeout_s)
        if isinstance(message, CloseCharacter):
            self.leave()
        noticed = (PATIENCE_S, HEALTH_S) if self._services.rescue_s > 0 else ()
        while True:
            try:
                left_s = max(until - time.monotonic(), BUSY_S)
                return await self._slot.ask(kind, message, self._character_id, left_s, *noticed)
            except OverloadedError:
                # A tracker that is full is not so for a moment: who asks for a character is told at once.
                if isinstance(message, CreateCharacter) or time.monotonic() + BUSY_S >= until:
                    raise
                await asyncio.sleep(BUSY_S)

    def take_swap_error(self) -> str | None:
        """Why the character could not go over to the tracker that was swapped in; told once."""
        error, self._swap_error = self._swap_error, None
        return error

    async def follow_swaps(self) -> None:
        """At a plan boundary: if another tracker was put in the slot, let it drive; move there if it is elsewhere.

        A move that fails leaves the character where it is; `take_swap_error` tells why.
        """
        old, new = self._slot, self._services.tracker
        if new is self._followed:
            return
        self._followed = new
        try:
            if new.endpoint != old.endpoint:
                kept = await self.ask(Snapshot, TakeSnapshot())
                await new.ask(StateFrame, restore_of(kept), self._character_id, self._timeout_s)
            await new.ask(Ok, SetTracker(tracker=new.plugin_name), self._character_id, self._timeout_s)
        except MotionLoopError as error:
            self._swap_error = error.message
            return
        self._move_to(new)
        self._swap_error = None
        if new.endpoint != old.endpoint:
            with contextlib.suppress(MotionLoopError):  # the old service may be on its way out
                await old.ask(Ok, CloseCharacter(), self._character_id, self._timeout_s)

    async def find_again(
        self,
        kept: Snapshot,
        goes_on: bool,
        patience_s: float,
        given_up: Callable[[], bool],
        most_ahead_ticks: int | None = None,
    ) -> tuple[StateFrame, bool]:
        """The character after its tracker was lost: as it is where it still lives, else made anew from a snapshot.

        Its own tracker is asked first, then the others, the least loaded first, again and again.

        Args:
            kept: what it is made from.
            goes_on: whether one that still lives is taken as it is; else it is put back to the snapshot.
            patience_s: how long to look.
            given_up: whether nobody wants it any more.
            most_ahead_ticks: one that is further on than this is put back too.

        Returns:
            Its state, and whether it was put back to the snapshot.

        Raises what the last tracker that was asked has answered.
        """
        until, alive_s = time.monotonic() + patience_s, ALIVE_S
        while True:
            failure: MotionLoopError
            for slot in (self._slot, *self._services.others(self._slot)):
                try:
                    return await self._at(slot, kept, goes_on, most_ahead_ticks, alive_s)
                except MotionLoopError as error:
                    failure = error
            if given_up() or time.monotonic() >= until:
                raise failure
            await asyncio.sleep(TRY_AGAIN_S)
            alive_s = min(alive_s * PATIENCE_GROWS, MOST_ALIVE_S)

    async def _at(
        self, slot: Slot, kept: Snapshot, goes_on: bool, most_ahead_ticks: int | None, alive_s: float
    ) -> tuple[StateFrame, bool]:
        await slot.client.ask(Health(), HealthReport, timeout_s=alive_s)
        if goes_on and slot is self._slot:
            with contextlib.suppress(NotFoundError):
                there = await slot.client.ask(Observe(), StateFrame, self._character_id, timeout_s=self._timeout_s)
                ahead = there.tick - kept.tick
                if ahead >= 0 and (most_ahead_ticks is None or ahead <= most_ahead_ticks):
                    return there, False
        state = await slot.client.ask(restore_of(kept), StateFrame, self._character_id, timeout_s=self._timeout_s)
        old = self._slot
        self._move_to(slot)
        if old is not slot:
            self._services.leave_behind(old, self._character_id)
        return state, True

    def _move_to(self, slot: Slot) -> None:
        self._slot = slot
        self._services.residents[self._character_id] = slot
