"""The recording of a running episode: gathered whenever something is kept of its character, written beside the loop."""

from __future__ import annotations

import asyncio
import time

from orchestrator.core.drivers import Cycle
from orchestrator.core.episode import EpisodeRunner
from orchestrator.core.keepsake import EpisodeState, Keepsake
from orchestrator.store.recordings import Recording, RecordingFiles, joined
from orchestrator.store.resume import to_bytes
from shared.errors import MotionLoopError
from shared.protocol.messages import TICK_HZ

ASK_TICKS = 600
"""Ticks that are asked for at once."""
WRITE_S = 0.5
"""A part is written so often, by the wall clock, where something new is kept; a kill costs no older ticks."""


class Tape:
    """What has happened in an episode up to what is kept of its character, and the way of it to the disk.

    A tick is on the tape once: when a character is put back, it is to the moment up to which it was recorded.

    Args:
        runner: of the episode.
        files: where recordings lie.
        recorded_to: what is there already, of a life before.
    """

    def __init__(self, runner: EpisodeRunner, files: RecordingFiles, recorded_to: int = 0):
        self._runner = runner
        self._files = files
        self._recorded_to = recorded_to
        self._pending: list[Recording] = []
        self._writing: asyncio.Task[None] | None = None
        self._kept: tuple[Keepsake, EpisodeState] | None = None
        self._written_s = float("-inf")  # what is kept first is written at once
        self._refused = False
        runner.session.on_keep = self.keep

    async def keep(self, kept: Keepsake) -> None:
        """Take the ticks up to the keepsake's, and see that tape and keepsake come to the disk.

        Raises MotionLoopError where the tracker does not have them.
        """
        await self._take(kept.tick + 1)
        self._kept = kept, self._runner.remembered()
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
        """Take and write what is left, and make the episode's one file of it; False where the disk refuses.

        Until `drop` another process could still take the episode up.
        """
        await self._written()
        self._kept = None
        if self._runner.session.created and self._recorded_to < stop_tick:
            try:
                await self._take(stop_tick)
            except MotionLoopError as error:
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

    async def _take(self, stop_tick: int) -> None:
        new: list[Recording] = []
        at, session = self._recorded_to, self._runner.session
        while at < stop_tick:
            stop = min(at + ASK_TICKS, stop_tick)
            part = await session.loop.ticks(at, stop, TICK_HZ, reference=True)
            new.append(Recording.of(part, self._runner.spec.character, session.scene))
            at = stop
        self._pending += new
        self._recorded_to = max(self._recorded_to, stop_tick)

    async def _write(self) -> None:
        parts, kept = list(self._pending), self._kept
        try:
            await asyncio.to_thread(self._put, parts, kept)
        except OSError as error:  # what cannot be written now stays here and is tried again
            self._told(error)
        else:
            del self._pending[: len(parts)]
            if self._refused:
                self._refused = False
                self._runner.events.emit("recording_goes_on", self._runner.tick)
        self._written_s = time.monotonic()

    def _put(self, parts: list[Recording], kept: tuple[Keepsake, EpisodeState] | None) -> None:
        if parts:
            self._files.add_part(self._runner.episode_id, joined(parts))
        if kept is not None:
            self._files.add_resume(self._runner.episode_id, to_bytes(*kept))

    def _told(self, error: Exception) -> None:
        """Say once that the disk refuses, until it does not any more."""
        if not self._refused:
            self._refused = True
            self._runner.events.emit("recording_failed", self._runner.tick, reason=str(error))
