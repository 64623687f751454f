"""Events of a character or an episode: numbered, kept, and streamed to whoever listens."""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Sequence
from typing import Any

from orchestrator.rest import Event

KEPT_EVENTS = 2000
QUEUED_EVENTS = 256


class EventLog:
    """The events of one character or episode.

    Args:
        sink: called with every event (the store); must not block for long.
        earlier: events of a life before, which are not told to the sink again.
    """

    def __init__(self, sink: Callable[[Event], None] | None = None, earlier: Sequence[Event] = ()):
        self._events: deque[Event] = deque(earlier, maxlen=KEPT_EVENTS)
        self._sink = sink
        self._listeners: set[asyncio.Queue[Event | None]] = set()
        self._seq = earlier[-1].seq if earlier else 0
        self.closed = False

    def emit(self, type: str, tick: int, /, **data: Any) -> Event:
        """Add an event."""
        self._seq += 1
        event = Event(seq=self._seq, type=type, tick=tick, unix_s=time.time(), data=data)
        self._events.append(event)
        if self._sink is not None:
            self._sink(event)
        for queue in self._listeners:
            if queue.full():
                queue.get_nowait()  # a listener that cannot keep up loses the oldest, nobody waits for it
            queue.put_nowait(event)
        return event

    def since(self, seq: int) -> list[Event]:
        """Kept events after number `seq`."""
        return [event for event in self._events if event.seq > seq]

    def close(self) -> None:
        """No more events: listeners end after the last one."""
        self.closed = True
        for queue in self._listeners:
            if queue.full():
                queue.get_nowait()
            queue.put_nowait(None)

    async def listen(self, since: int = 0) -> AsyncIterator[Event]:
        """The kept events after `since`, then new ones until the log is closed."""
        queue: asyncio.Queue[Event | None] = asyncio.Queue(QUEUED_EVENTS)
        self._listeners.add(queue)
        try:
            last = since
            for event in self.since(since):
                last = event.seq
                yield event
            if self.closed:
                return
            while (following := await queue.get()) is not None:
                if following.seq > last:
                    last = following.seq
                    yield following
        finally:
            self._listeners.discard(queue)


def captions_of(events: Sequence[Event]) -> list[tuple[int, str]]:
    """What an episode's video says from which tick on: the task under way, attempts that were missed included."""
    return [(event.tick, str(event.data["label"])) for event in events if event.type == "task_begin"]
