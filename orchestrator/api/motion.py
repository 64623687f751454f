"""Motion as files: of an episode that is over, and of a character while it lives."""

from __future__ import annotations

import asyncio
from typing import Annotated

from fastapi import APIRouter, Query, Response

from orchestrator.api.deps import CharacterId, Core, EpisodeId
from orchestrator.api.problems import RESPONSES
from orchestrator.core.character import CharacterSession
from orchestrator.export.formats import MEDIA_TYPES, Format, Unit, exported
from orchestrator.store.recordings import Recording, joined
from shared.errors import ConflictError
from shared.protocol.messages import TICK_HZ

router = APIRouter(prefix="/v1", tags=["motion"], responses=RESPONSES)

PART_TICKS = 600
BvhUnit = Annotated[
    Unit, Query(description="length unit of BVH: `m` is to scale in Blender, `cm` is what many tools expect")
]
Seconds = Annotated[float, Query(gt=0, le=600, description="how far back from now")]
UntilTick = Annotated[int | None, Query(ge=0, description="the last tick (30 Hz); now if not given")]


@router.get("/episodes/{episode_id}/motion.{suffix}", response_class=Response)
async def episode_motion(core: Core, episode_id: EpisodeId, suffix: Format, unit: BvhUnit = "m") -> Response:
    """The recorded motion at 30 Hz."""
    key = str(episode_id)
    row = await core.reader.episode(key)
    if row["status"] == "running":
        raise ConflictError("the episode is still running", field="id")
    recording = await asyncio.to_thread(core.files.load, key)
    return await _answer(recording, suffix, unit, key)


@router.get("/characters/{character_id}/motion.{suffix}", response_class=Response)
async def character_motion(
    core: Core,
    character_id: CharacterId,
    suffix: Format,
    seconds: Seconds = 60.0,
    unit: BvhUnit = "m",
    until_tick: UntilTick = None,
) -> Response:
    """What a character did of late, or before a tick, at 30 Hz."""
    session = core.character(str(character_id))
    recording = await recording_of(session, seconds, until_tick)
    return await _answer(recording, suffix, unit, str(character_id))


async def recording_of(session: CharacterSession, seconds: float, until_tick: int | None = None) -> Recording:
    """Seconds of a character's life up to a tick (None: up to now), from the tracker's log."""
    state = await session.loop.observe()
    stop = min(state.tick if until_tick is None else until_tick, state.tick) + 1
    start = max(0, stop - round(seconds * TICK_HZ))
    parts = []
    for begin in range(start, stop, PART_TICKS):
        part = await session.loop.ticks(begin, min(begin + PART_TICKS, stop), TICK_HZ, reference=True)
        parts.append(Recording.of(part, session.spec.character, session.scene))
    return joined(parts)


async def _answer(recording: Recording, suffix: Format, unit: Unit, name: str) -> Response:
    data = await asyncio.to_thread(exported, recording, suffix, unit)
    headers = {"Content-Disposition": f'attachment; filename="{name}.{suffix}"'}
    return Response(data, media_type=MEDIA_TYPES[suffix], headers=headers)
