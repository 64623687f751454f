"""The wall clock of realtime characters: 30 ticks a second each, whatever else is late."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from math import inf

from shared.errors import ConflictError
from shared.protocol.messages import TICK_HZ, StateFrame
from tracker_service.service.hosted import HostedCharacter

PERIOD_S = 1.0 / TICK_HZ
log = logging.getLogger(__name__)


@dataclass
class _Entry:
    character: HostedCharacter
    due_s: float
    running: bool = False


@dataclass(frozen=True)
class Due:
    """What a tick that was due at some time means for the next: see `keep_time`."""

    missed_ticks: int
    next_due_s: float


def keep_time(due_s: float, done_s: float, catch_up_ticks: int) -> Due:
    """Account for a tick that was due at `due_s` and done at `done_s`.

    A tick is missed when it is done more than one period after it was due. The next one is due a period after this one;
    a clock further behind than `catch_up_ticks` skips the ticks between, counting each as missed.
    """
    late_s = done_s - due_s
    missed = int(late_s > PERIOD_S)
    next_due_s = due_s + PERIOD_S
    behind = int((done_s - next_due_s) / PERIOD_S)
    if behind >= catch_up_ticks:
        missed += behind
        next_due_s += behind * PERIOD_S
    return Due(missed, next_due_s)


class RealtimeClock:
    """A thread that has each of its characters advanced when its tick is due.

    Args:
        on_frame: gets each frame.
        workers: threads that advance characters.
        catch_up_ticks: see `keep_time`.
        now: monotonic seconds.
    """

    def __init__(
        self,
        on_frame: Callable[[StateFrame], None],
        workers: int = 2,
        catch_up_ticks: int = 6,
        now: Callable[[], float] = time.monotonic,
    ):
        self._on_frame = on_frame
        self._catch_up_ticks = catch_up_ticks
        self._now = now
        self._entries: dict[str, _Entry] = {}
        self._changed = threading.Condition()
        self._waits_until_s = -inf
        self._stopping = False
        self._pool = ThreadPoolExecutor(workers, thread_name_prefix="realtime")
        self._thread = threading.Thread(target=self._run, name="realtime-clock", daemon=True)

    def start(self) -> None:
        """Begin to keep time."""
        self._thread.start()

    def stop(self) -> None:
        """Stop all clocks; ticks under way are finished. Safe to call twice."""
        with self._changed:
            self._stopping = True
            self._changed.notify_all()
        if self._thread.is_alive():
            self._thread.join()
        self._pool.shutdown(wait=True, cancel_futures=True)

    def add(self, character: HostedCharacter) -> None:
        """Advance a character from one period from now on; one that is there already keeps its time."""
        with self._changed:
            entry = self._entries.get(character.character_id)
            if entry is None or entry.character is not character:
                self._entries[character.character_id] = _Entry(character, self._now() + PERIOD_S)
                self._changed.notify_all()

    def remove(self, character_id: str) -> None:
        """Leave a character to stand still; a tick under way is finished."""
        with self._changed:
            self._entries.pop(character_id, None)

    def _run(self) -> None:
        with self._changed:
            while not self._stopping:
                now = self._now()
                waiting = [entry for entry in self._entries.values() if not entry.running]
                for entry in waiting:
                    if entry.due_s <= now:
                        entry.running = True
                        self._pool.submit(self._tick, entry)
                due = min((entry.due_s for entry in waiting if not entry.running), default=now + 1.0)
                self._waits_until_s = due
                self._changed.wait(max(0.0, due - now))

    def _tick(self, entry: _Entry) -> None:
        character = entry.character
        frame: StateFrame | None = None
        try:
            frame = character.realtime_tick()
        except ConflictError:
            log.debug("%s was closed while its tick was due", character.character_id)
        except Exception:  # nothing that a tick raises may stop its clock; what it was is in the character's failure
            log.exception("a tick of %s failed", character.character_id)
        done = keep_time(entry.due_s, self._now(), self._catch_up_ticks)
        character.clock.missed_ticks += done.missed_ticks
        if frame is not None:  # before the next tick may begin, so that frames leave in order
            try:
                self._on_frame(frame)
            except Exception:
                log.exception("a frame of %s could not be published", character.character_id)
        with self._changed:
            entry.due_s, entry.running = done.next_due_s, False
            if entry.due_s < self._waits_until_s:  # else the clock wakes in time by itself
                self._changed.notify_all()
