"""The span of the first tick that is computed with a plan."""

from __future__ import annotations

from collections.abc import Callable

from shared import spans


class Entering:
    """Waits for the tick at which a character's newest plan enters.

    Args:
        character_id: whose.
    """

    def __init__(self, character_id: str):
        self._character_id = character_id
        self._waiting: tuple[int, Callable[[], spans.Open | None]] | None = None

    def expect(self, tick: int) -> None:
        """A plan enters at this tick; called within the span of the message that brought it."""
        span = spans.later("tick", character=self._character_id, tick=tick)
        self._waiting = None if span is None else (tick, span)

    def ticked(self, now: int) -> None:
        """Tick `now` has been reached."""
        if self._waiting is not None and now > self._waiting[0]:
            span, self._waiting = self._waiting[1], None
            spans.end(span())
