"""A disk that refuses for long: what waits for it is bounded, and nothing is lost."""

from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import Callable
from pathlib import Path

import pytest

from orchestrator.core.episode_spec import EpisodeSpec
from orchestrator.core.supervise import Stack
from orchestrator.core.tape import ASK_TICKS, MEGABYTE
from orchestrator.rest import Event
from shared.errors import OverloadedError
from tests.orchestrator.support import arrays_in, light, orchestrator_on

SPEC = EpisodeSpec.model_validate({"tasks": [{"type": "halt", "duration_s": 25}], "pacing": "lockstep", "seed": 5})
MOST_MB = 0.5
"""A few hundred ticks of one character."""
TICK_BYTES = 4000
"""More than one of them takes."""


async def played(
    stack: Stack, folder: Path, blocked: bool = False, meddle: Callable[[Event], None] | None = None
) -> tuple[dict[str, bytes], list[Event], int]:
    """The episode's recording, its events, and the most bytes that were held.

    Args:
        blocked: its parts cannot be written, as a file is where their folder should be, until it has ended or its
            tracker has been lost.
        meddle: called with each event.
    """
    core = await orchestrator_on(stack, folder, MOST_MB)
    events: list[Event] = []
    held: list[int] = []
    in_the_way: list[Path] = []

    def see(event: Event) -> None:
        events.append(event)
        held.append(core.backlog.held_bytes)
        if event.type == "recording_behind":
            with pytest.raises(OverloadedError, match="a disk that refuses"):
                core.start_episode(SPEC)
        if meddle is not None:
            meddle(event)
        if event.type in ("end", "tracker_back") and in_the_way:
            in_the_way.pop().unlink()

    core.observers.append(see)
    try:
        episode_id = core.start_episode(SPEC)
        if blocked:
            in_the_way.append(folder / "recordings" / f"{episode_id}.parts")
            in_the_way[0].touch()
        task = core.episodes[episode_id].task
        assert task is not None
        await task
        assert core.backlog.held_bytes == 0
        return arrays_in(core.files.path(episode_id)), events, max(held)
    finally:
        await core.close()


def test_what_waits_for_a_disk_is_bounded_and_comes_to_it_whole(tmp_path: Path) -> None:
    """What is beyond the bound is with the tracker; where that dies too, it is done once more."""
    stack = Stack(light(tmp_path / "data"))

    def kill(event: Event) -> None:
        if event.type == "recording_behind":
            os.kill(stack.tracker.pid, signal.SIGKILL)
            stack.restart("tracker")

    try:
        stack.start_services()
        wanted, _, _ = asyncio.run(played(stack, tmp_path / "undisturbed"))
        for meddle in (None, kill):
            arrays, events, most_bytes = asyncio.run(played(stack, tmp_path / f"{meddle}", True, meddle))
            kinds = [event.type for event in events]
            assert kinds.count("recording_failed") >= 1 and kinds.count("recording_behind") >= 1
            # Until the disk takes it, it is said once; with the tracker back the disk does, and may be late once more.
            assert kinds.count("recording_behind") == 1 or meddle is kill
            assert ("tracker_back" in kinds) == (meddle is kill)
            # What is over the bound is at most what was asked for at once.
            assert MOST_MB * MEGABYTE <= most_bytes < MOST_MB * MEGABYTE + ASK_TICKS * TICK_BYTES
            assert arrays == wanted
    finally:
        stack.stop()
