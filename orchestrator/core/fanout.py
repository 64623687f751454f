"""One producer, many listeners that only want the newest: slow ones skip, nobody waits for them."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Generic, TypeVar

T = TypeVar("T")


class Fanout(Generic[T]):
    """Hands every published value to all listeners; a listener that is behind sees only the newest."""

    def __init__(self) -> None:
        self._changed = asyncio.Event()
        self._value: T | None = None
        self._closed = False

    def publish(self, value: T) -> None:
        """Replace the value and wake the listeners."""
        self._value = value
        self._wake()

    def close(self) -> None:
        """End the listeners."""
        self._closed = True
        self._wake()

    def _wake(self) -> None:
        changed, self._changed = self._changed, asyncio.Event()
        changed.set()

    async def listen(self) -> AsyncIterator[T]:
        """Values from the present one on, until closed."""
        seen: T | None = None
        while True:
            changed = self._changed
            if self._value is not None and self._value is not seen:
                seen = self._value
                yield seen
                continue
            if self._closed:
                return
            await changed.wait()
