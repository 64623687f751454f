"""The two services as the orchestrator sees them: a slot each, whose occupant can be exchanged while in use."""

from __future__ import annotations

import asyncio
import contextlib
from dataclasses import dataclass, field
from typing import Any, TypeVar

from orchestrator.core.scenes import Scenes
from shared.errors import MotionLoopError, UnavailableError
from shared.plugins.registry import current_name
from shared.protocol.base import Message
from shared.protocol.control import Health, HealthReport, Welcome
from shared.protocol.security import CurveKeys
from shared.protocol.transport import AsyncServiceClient, Kind

Reply = TypeVar("Reply", bound=Message)

PATIENCE_S = 2.0
"""After so long without a reply the service is asked whether it is alive."""
HEALTH_S = 5.0
"""A service that does not say within this how it is counts as gone; a machine under load must not look like that."""


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
        self, kind: type[Reply], message: Message, character_id: str | None = None, timeout_s: float = 10.0
    ) -> Reply:
        """The reply of type `kind`. A service that is gone is noticed after a few seconds, whatever the deadline.

        Raises:
            UnavailableError: it does not answer, not even a question for its health.
            MotionLoopError: what the service replied, or DeadlineError.
        """
        task = asyncio.create_task(self.client.ask(message, kind, character_id, timeout_s=timeout_s))
        try:
            while True:
                done, _ = await asyncio.wait({task}, timeout=PATIENCE_S)
                if done:
                    return task.result()
                try:
                    await self.client.ask(Health(), HealthReport, timeout_s=HEALTH_S)
                except MotionLoopError as error:
                    if not task.done():
                        raise UnavailableError(f"the service at {self.endpoint} does not answer") from error
        finally:
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError, MotionLoopError):
                await task


@dataclass
class Services:
    """Planner, tracker and scenes. Loops look a slot up at every request, so that a swap shows at the next plan."""

    planner: Slot
    tracker: Slot
    scenes: Scenes = field(default_factory=Scenes)

    async def close(self) -> None:
        """Close both clients."""
        await self.planner.client.close()
        await self.tracker.client.close()


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
