"""The recording of a running episode: gathered whenever something is kept of its character, written beside the loop."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence

from orchestrator.core.drivers import Cycle
from orchestrator.core.episode import EpisodeRunner
from orchestrator.core.keepsake import EpisodeState, Keepsake
from orchestrator.store.recordings import Recording, RecordingFiles, joined
from orchestrator.store.resume import to_bytes
from shared.errors import MotionLoopError, OverloadedError, TransportError
from shared.protocol.messages import TICK_HZ

ASK_TICKS = 600
"""Ticks that are asked for at once."""
CATCH_UP_TICKS = 3 * ASK_TICKS
"""A loop that runs is not held up for more of them."""
WRITE_S = 0.5
"""A part is written so often, by the wall clock, where something new is kept; a kill costs no older ticks."""
MOST_UNHEARD = 6
"""So often a tracker that is not heard is asked again, once the episode is over, before what it has is given up."""
MEGABYTE = 2**20


class Backlog:
    """What is recorded and not yet written, of all episodes together.

    Args:
        most_bytes: beyond this no more is taken from the trackers, which have the ticks in logs of their own.
    """

    def __init__(self, most_bytes: int):
        self.most_bytes = most_bytes
        self.held_bytes = 0

    @property
    def full(self) -> bool:
        """Whether no more is taken until something is written."""
        return self.held_bytes >= self.most_bytes

    def check_room(self) -> None:
        """Raises OverloadedError where there is none."""
        if self.full:
            raise OverloadedError(
                f"recordings of {self.held_bytes / MEGABYTE:.1f} MB wait for a disk that refuses them",
                allowed=f"less than {self.most_bytes / MEGABYTE:g} MB",
            )

    def add(self, parts: Sequence[Recording]) -> None:
        """They are held from now on."""
        self.held_bytes += sum(part.nbytes for part in parts)

    def remove(self, parts: Sequence[Recording]) -> None:
        """They are written, or not wanted any more."""
        self.held_bytes -= sum(part.nbytes for part in parts)


class Tape:
    """What has happened in an episode up to what is kept of its character, and the way of it to the disk.

    A tick is on the tape once: when a character is put back, it is to the moment up to which it was recorded, and what
    was taken since is taken off again.

    Args:
        runner: of the episode.
        files: where recordings lie.
        backlog: while it is full nothing more is taken and kept: the ticks stay with the tracker.
        recorded_to: what is there already, of a life before.
    """

    def __init__(self, runner: EpisodeRunner, files: RecordingFiles, backlog: Backlog, recorded_to: int = 0):
        self._runner = runner
        self._files = files
        self._backlog = backlog
        self._recorded_to = recorded_to
        self._pending: list[Recording] = []
        self._writing: asyncio.Task[None] | None = None
        self._kept: tuple[Keepsake, EpisodeState] | None = None
        self._cut_after: int | None = None
        self._written_s = float("-inf")  # what is kept first is written at once
        self._refused = False
        self._behind = False
        self._unheard = 0
        runner.session.on_keep = self.keep
        runner.session.on_rewind.append(self._put_back)

    async def keep(self, kept: Keepsake) -> None:
        """Take the ticks up to the keepsake's, and see that tape and keepsake come to the disk.

        Raises MotionLoopError where the tracker does not have them, OverloadedError while they stay there.
        """
        try:
            await self._take(kept.tick + 1, CATCH_UP_TICKS)
            self._kept = kept, self._runner.remembered()
            self._behind = False
        except OverloadedError as error:
            self._tell_behind(error)
            raise
        finally:
            writing = self._writing is not None and not self._writing.done()
            if not writing and time.monotonic() - self._written_s >= WRITE_S:
                self._writing = asyncio.create_task(self._write(), name="tape")

    async def wind(self, cycle: Cycle) -> None:
        """Called after each cycle: where plans last long, something is kept in between."""
        if time.monotonic() - self._written_s >= WRITE_S:
            self._runner.session.keep_soon()

    async def leave(self) -> None:
        """Write what is there: another process will go on with the episode."""
        await self._written()
        await self._write()

    async def _written(self) -> None:
        if self._writing is not None:
            await self._writing

    async def finish(self, stop_tick: int) -> bool:
        """Take and write what is left, and make the episode's one file of it; False where the disk refuses or the
        tracker is not heard.

        Until `drop` another process could still take the episode up.
        """
        await self._written()
        self._kept = None
        while self._runner.session.created and self._recorded_to < stop_tick:
            try:
                await self._take(stop_tick, CATCH_UP_TICKS)
            except OverloadedError as error:
                self._tell_behind(error)
                await self._write()
                if self._backlog.full:
                    return False
            except MotionLoopError as error:
                if isinstance(error, TransportError) and self._unheard < MOST_UNHEARD:
                    self._unheard += 1  # it may have them all the same, and only be slow
                    await self._write()
                    return False
                self._runner.events.emit("recording_failed", self._runner.tick, reason=error.message)
                self._recorded_to = stop_tick  # said once: the tracker will not have them later
        await self._write()
        if self._pending:
            return False
        try:
            await asyncio.to_thread(self._files.finish, self._runner.episode_id, False)
        except (OSError, ValueError, KeyError) as error:
            self._told(error)
            return False
        return True

    async def drop(self) -> None:
        """The episode is over and noted: the parts of its recording are not needed any more."""
        await asyncio.to_thread(self._files.drop_parts, self._runner.episode_id)

    def discard(self) -> None:
        """Nobody wants it any more."""
        self._backlog.remove(self._pending)
        self._pending = []

    def _put_back(self, tick: int) -> None:
        """The character was put back: what is on the tape of later ticks, taken and not yet kept, goes."""
        if self._recorded_to <= tick + 1:
            return
        gone = [part for part in self._pending if part.start_tick > tick]
        self._pending = [part for part in self._pending if part.start_tick <= tick]
        self._backlog.remove(gone)
        self._recorded_to, self._cut_after = tick + 1, tick

    async def _take(self, stop_tick: int, most: int) -> None:
        """Get the ticks up to `stop_tick` from the tracker; raises OverloadedError after `most` of them, or where there
        is no room. What has come by then stays."""
        session, first = self._runner.session, self._recorded_to
        while self._recorded_to < stop_tick:
            self._backlog.check_room()
            if self._recorded_to - first >= most:
                raise OverloadedError(f"ticks {self._recorded_to}..{stop_tick - 1} are still to be recorded")
            stop = min(self._recorded_to + ASK_TICKS, stop_tick)
            part = await session.loop.ticks(self._recorded_to, stop, TICK_HZ, reference=True)
            new = Recording.of(part, self._runner.spec.character, session.scene)
            self._pending.append(new)
            self._backlog.add((new,))
            self._recorded_to = stop

    async def _write(self) -> None:
        parts, kept, cut_after = list(self._pending), self._kept, self._cut_after
        try:
            await asyncio.to_thread(self._put, parts, kept, cut_after)
        except OSError as error:  # what cannot be written now stays here and is tried again
            self._told(error)
        else:
            written = {id(part) for part in parts}
            done = [part for part in self._pending if id(part) in written]
            self._pending = [part for part in self._pending if id(part) not in written]
            self._backlog.remove(done)
            if self._cut_after == cut_after:
                self._cut_after = None
            if self._refused:
                self._refused = False
                self._runner.events.emit("recording_goes_on", self._runner.tick)
        self._written_s = time.monotonic()

    def _put(self, parts: list[Recording], kept: tuple[Keepsake, EpisodeState] | None, cut_after: int | None) -> None:
        if cut_after is not None:
            self._files.drop_after(self._runner.episode_id, cut_after)
        # What is kept is taken up from the end of a part: later ticks are in parts of their own.
        last = parts[-1].start_tick if kept is None and parts else -1 if kept is None else kept[0].tick
        for group in ([p for p in parts if p.start_tick <= last], [p for p in parts if p.start_tick > last]):
            if group:
                self._files.add_part(self._runner.episode_id, joined(group))
        if kept is not None:
            self._files.add_resume(self._runner.episode_id, to_bytes(*kept), kept[0].tick)

    def _told(self, error: Exception) -> None:
        """Say once that the disk refuses, until it does not any more."""
        if not self._refused:
            self._refused = True
            self._runner.events.emit("recording_failed", self._runner.tick, reason=str(error))

    def _tell_behind(self, error: OverloadedError) -> None:
        """Say once that the recording stays behind, until it has caught up."""
        if self._backlog.full and not self._behind:
            self._behind = True
            recorded = self._recorded_to
            self._runner.events.emit("recording_behind", self._runner.tick, reason=error.message, recorded_to=recorded)
