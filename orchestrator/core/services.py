"""The two services as the orchestrator sees them: a slot each, whose occupant can be exchanged while in use."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from dataclasses import dataclass, field
from typing import Any, TypeVar

from orchestrator.core.lead import PlanLead
from orchestrator.core.scenes import Scenes
from shared.errors import MotionLoopError, UnavailableError
from shared.plugins.registry import current_name
from shared.protocol.base import Message
from shared.protocol.control import Health, HealthReport, Ok, Welcome
from shared.protocol.messages import CloseCharacter
from shared.protocol.security import CurveKeys
from shared.protocol.transport import AsyncServiceClient, Kind

log = logging.getLogger(__name__)

Reply = TypeVar("Reply", bound=Message)

PATIENCE_S = 2.0
"""After so long without a reply the service is asked whether it is alive."""
HEALTH_S = 5.0
"""A service that does not say within this how it is counts as gone; a machine under load must not look like that."""
DOUBT_S = 0.25
"""One that let a deadline pass in silence is asked for its health so soon: its first answer makes whatever waits for
it be sent again."""
LEFT_BEHIND_S = 600.0
EXPECTED_S = 1.0
"""A tracker that is not there is asked again after so long."""


@dataclass(frozen=True)
class Slot:
    """A service in use: its client, what it said in the first handshake, and the plug-in asked for by default."""

    client: AsyncServiceClient
    welcome: Welcome
    plugin: str | None = None

    @property
    def endpoint(self) -> str:
        """Where it listens."""
        return self.client.peer.endpoint

    @property
    def present(self) -> Welcome:
        """What it said in the last handshake: a service that was restarted may be another one."""
        return self.client.welcome or self.welcome

    @property
    def plugin_name(self) -> str:
        """The plug-in in use unless a character names another."""
        return current_name(self.plugin or self.present.default_plugin)

    def spec(self, plugin: str | None = None) -> dict[str, Any]:
        """What the plug-in declared in the handshake; empty for one that the service does not offer."""
        name = current_name(plugin) if plugin else self.plugin_name
        return next((dict(spec) for spec in self.present.plugins if spec.get("name") == name), {})

    async def ask(
        self,
        kind: type[Reply],
        message: Message,
        character_id: str | None = None,
        timeout_s: float = 10.0,
        patience_s: float = PATIENCE_S,
        health_s: float = HEALTH_S,
    ) -> Reply:
        """The reply of type `kind`. A service that is gone is noticed after a few seconds, whatever the deadline: after
        `patience_s` without a reply it is asked how it is, and has `health_s` to say so.

        Raises:
            UnavailableError: it does not answer, not even a question for its health.
            MotionLoopError: what the service replied, or DeadlineError.
        """
        task = asyncio.create_task(self.client.ask(message, kind, character_id, timeout_s=timeout_s))
        health: asyncio.Task[HealthReport] | None = None
        try:
            while True:
                await asyncio.wait({task}, timeout=min(patience_s, DOUBT_S) if self.client.in_doubt else patience_s)
                if task.done():
                    return task.result()
                health = asyncio.create_task(self.client.ask(Health(), HealthReport, timeout_s=health_s))
                # A request that ends meanwhile has said enough.
                await asyncio.wait({task, health}, return_when=asyncio.FIRST_COMPLETED)
                if task.done():
                    return task.result()
                try:
                    health.result()
                except MotionLoopError as error:
                    raise UnavailableError(f"the service at {self.endpoint} does not answer") from error
        finally:
            for each in (task, health):
                if each is not None:
                    each.cancel()
                    with contextlib.suppress(asyncio.CancelledError, MotionLoopError):
                        await each


@dataclass
class Services:
    """Planner, trackers and scenes. Loops look a slot up at every request, so that a swap shows at the next plan.

    Attributes:
        tracker: the first; its plug-ins are the ones that can be asked for, and it is the one that a swap exchanges.
        spares: more trackers, which take characters in too; `expect` adds those that come later.
        rescue_s: how long a character whose tracker was lost is tried to be brought back, from what is kept of it at
            each plan; 0 keeps nothing, and it has failed at once.
        residents: where each character lives.
        leads: how far ahead plans are asked for by the clock, by name of the planner plug-in.
    """

    planner: Slot
    tracker: Slot
    scenes: Scenes = field(default_factory=Scenes)
    spares: list[Slot] = field(default_factory=list)
    rescue_s: float = 0.0
    residents: dict[str, Slot] = field(default_factory=dict)
    leads: dict[str, PlanLead] = field(default_factory=dict)
    _leaving: set[asyncio.Task[None]] = field(default_factory=set)
    _expecting: set[asyncio.Task[None]] = field(default_factory=set)
    _ended: set[str] = field(default_factory=set)

    def place(self) -> Slot:
        """The tracker for a new character: the one with the fewest, of equals the first."""
        return min((self.tracker, *self.spares), key=self._load)

    def lead(self, planner: str) -> PlanLead:
        """Of a planner plug-in: its characters wait for each other there."""
        return self.leads.setdefault(planner, PlanLead())

    def others(self, slot: Slot) -> list[Slot]:
        """The trackers but one, those with the fewest characters first."""
        there = [each for each in (self.tracker, *self.spares) if each.endpoint != slot.endpoint]
        return sorted(there, key=self._load)

    def leave_behind(self, slot: Slot, character_id: str) -> None:
        """End a character at a tracker that does not answer, once it does again: it lives elsewhere now."""
        task = asyncio.create_task(_close_later(slot, character_id), name=f"left-behind-{character_id}")
        self._leaving.add(task)
        task.add_done_callback(self._leaving.discard)

    def leave_all_behind(self, character_id: str) -> None:
        """End a character of an earlier process, wherever it is."""
        self._ended.add(character_id)
        for slot in (self.tracker, *self.spares):
            self.leave_behind(slot, character_id)

    def expect(self, endpoint: str, plugin: str | None = None, curve: CurveKeys | None = None) -> None:
        """Take a tracker that is not there yet among the spares once it is."""
        task = asyncio.create_task(self._join(endpoint, plugin, curve), name=f"expected-{endpoint}")
        self._expecting.add(task)
        task.add_done_callback(self._expecting.discard)

    async def _join(self, endpoint: str, plugin: str | None, curve: CurveKeys | None) -> None:
        told = ""
        while True:
            try:
                slot = await connect(endpoint, "tracker", plugin, curve)
                break
            except MotionLoopError as error:
                if error.message != told:
                    log.warning("the spare tracker at %s is not used: %s", endpoint, error.message)
                told = error.message
                await asyncio.sleep(EXPECTED_S)
        self.spares.append(slot)
        log.warning("the spare tracker at %s is there", endpoint)
        # What an earlier process had there has ended, or lives elsewhere.
        for character_id in self._ended | {each for each, home in self.residents.items() if home is not slot}:
            self.leave_behind(slot, character_id)

    async def close(self) -> None:
        """Close all clients."""
        pending = [*self._leaving, *self._expecting]
        for task in pending:
            task.cancel()
        await asyncio.gather(*pending, return_exceptions=True)
        for slot in (self.planner, self.tracker, *self.spares):
            await slot.client.close()

    def _load(self, slot: Slot) -> int:
        return sum(each is slot for each in self.residents.values())


async def _close_later(slot: Slot, character_id: str) -> None:
    with contextlib.suppress(MotionLoopError):
        await slot.client.ask(CloseCharacter(), Ok, character_id, timeout_s=LEFT_BEHIND_S)


async def connect(
    endpoint: str, kind: Kind, plugin: str | None = None, curve: CurveKeys | None = None, timeout_s: float = 5.0
) -> Slot:
    """Shake hands with a service and take it into a slot; closes the client again when it is unfit or away."""
    client = AsyncServiceClient(endpoint, kind, plugin=plugin, curve=curve, name="orchestrator")
    try:
        welcome = await client.connect(timeout_s)
    except BaseException:
        await client.close()
        raise
    return Slot(client, welcome, plugin)
