"""What the orchestrator needs of a store, whatever keeps it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, ParamSpec, Protocol, TypeVar

from orchestrator.core.episode_spec import EpisodeOutcome, EpisodeSpec
from orchestrator.rest import Event

P = ParamSpec("P")
T = TypeVar("T")

READERS = 4


class Store(Protocol):
    """Characters, episodes, events and results, over restarts.

    What is noted is taken at once, whatever the disk does, and is on disk a little later. What is asked for holds all
    that was noted before, and so may wait for the disk: in an event loop it is asked through `StoreReader`.
    """

    @property
    def recordings(self) -> Path:
        """Folder for recordings."""
        ...

    @property
    def failed_writes(self) -> int:
        """How often the disk refused."""
        ...

    def character_started(self, character_id: str, spec: dict[str, Any]) -> None:
        """Note a new character."""
        ...

    def character_ended(self, character_id: str, status: str) -> None:
        """Note its end."""
        ...

    def episode_started(self, episode_id: str, spec: EpisodeSpec, services: dict[str, Any]) -> None:
        """Note a running episode and what it runs on."""
        ...

    def episode_ended(self, episode_id: str, outcome: EpisodeOutcome) -> None:
        """Note its outcome and results."""
        ...

    def event(self, owner: str, event: Event) -> None:
        """Keep an event of a character or episode."""
        ...

    def delete_episode(self, episode_id: str) -> None:
        """Remove an episode and all that belongs to it."""
        ...

    def left_running(self) -> tuple[list[str], list[str]]:
        """On start: the episodes and the characters that a process which is no more was running. May wait."""
        ...

    def mark_interrupted(self, episodes: Sequence[str], characters: Sequence[str]) -> None:
        """Those that do not go on are interrupted. May wait."""
        ...

    def flush(self, timeout_s: float = 10.0) -> bool:
        """Wait until all that was noted is on disk; False when that took too long."""
        ...

    def episode(self, episode_id: str) -> dict[str, Any]:
        """One episode's row; raises NotFoundError. May wait."""
        ...

    def episodes(self, status: str | None, limit: int, offset: int) -> tuple[list[dict[str, Any]], int]:
        """Newest first; and how many there are in all. May wait."""
        ...

    def events(self, owner: str, since: int = 0) -> list[Event]:
        """Events of a character or episode after number `since`. May wait."""
        ...

    def close(self) -> None:
        """Write what is still to be written and end. May wait."""
        ...


class StoreReader:
    """Asks a store from an event loop: on threads of its own, so that a store that is stuck holds up nobody who asks
    for something else, not even for another file."""

    def __init__(self, store: Store):
        self._store = store
        self._threads = ThreadPoolExecutor(READERS, thread_name_prefix="store-reader")

    async def episode(self, episode_id: str) -> dict[str, Any]:
        """As `Store.episode`."""
        return await self._ask(self._store.episode, episode_id)

    async def episodes(self, status: str | None, limit: int, offset: int) -> tuple[list[dict[str, Any]], int]:
        """As `Store.episodes`."""
        return await self._ask(self._store.episodes, status, limit, offset)

    async def events(self, owner: str, since: int = 0) -> list[Event]:
        """As `Store.events`."""
        return await self._ask(self._store.events, owner, since)

    async def written(self, timeout_s: float) -> bool:
        """As `Store.flush`."""
        return await self._ask(self._store.flush, timeout_s)

    async def close(self) -> None:
        """Close the store, then the threads."""
        await self._ask(self._store.close)
        self._threads.shutdown(wait=False, cancel_futures=True)

    async def _ask(self, question: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        return await asyncio.get_running_loop().run_in_executor(self._threads, lambda: question(*args, **kwargs))
