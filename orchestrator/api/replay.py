"""What the page needs of recorded motion beyond files: an episode's frames to replay, and a film of a character."""

from __future__ import annotations

import asyncio
from typing import Annotated

import numpy as np
from fastapi import APIRouter, Query, Response

from orchestrator.api.binary import MEDIA_TYPE, pack
from orchestrator.api.deps import CharacterId, Core, EpisodeId
from orchestrator.api.problems import RESPONSES
from orchestrator.core.manager import RENDER_TIMEOUT_S
from shared.errors import ConflictError
from shared.protocol.messages import TICK_HZ, Render, Video

router = APIRouter(prefix="/v1", tags=["motion"], responses=RESPONSES)

MAX_FILM_S = 120
_OF_A_RESULT = ("label", "type", "start_tick", "stop_tick", "success_strict", "reason")

FilmSeconds = Annotated[float, Query(gt=0, le=MAX_FILM_S, description="how much of it")]
UntilTick = Annotated[int | None, Query(ge=0, description="the last tick (30 Hz); now if not given")]


@router.get("/episodes/{episode_id}/frames", response_class=Response)
async def episode_frames(core: Core, episode_id: EpisodeId) -> Response:
    """A finished episode's recording at 30 Hz as one block of bytes (layout: docs/page.md), to be replayed.

    Header: fps, start_tick, count, objects, results. Arrays, float32: positions_m (T, 22, 3), rotations_wxyz
    (T, 22, 4), reference_m (T or 0, 22, 3), object_poses (T, O, 7), tracking_error_m (T,), fallen (T,).
    """
    key = str(episode_id)
    row = await core.reader.episode(key)
    if row["status"] == "running":
        raise ConflictError("the episode is still running", field="id")
    recording = await asyncio.to_thread(core.files.load, key)
    results = [{name: result[name] for name in _OF_A_RESULT} for result in (row["outcome"] or {}).get("results", [])]
    header = {
        "type": "frames", "id": key, "fps": TICK_HZ, "start_tick": recording.start_tick, "count": len(recording),
        "objects": list(recording.objects), "results": results,
    }  # fmt: skip
    arrays = recording.arrays
    numbers = {
        "positions_m": arrays["body_pos_w_m"],
        "rotations_wxyz": arrays["body_quat_w"],
        "reference_m": arrays["reference_pos_w_m"],
        "object_poses": arrays["object_pose_w"],
        "tracking_error_m": arrays["tracking_error_m"],
        "fallen": arrays["fallen"],
    }
    return Response(await asyncio.to_thread(pack, header, numbers), media_type=MEDIA_TYPE)


@router.get("/characters/{character_id}/video.mp4", response_class=Response)
async def character_video(
    core: Core, character_id: CharacterId, seconds: FilmSeconds = 30.0, until_tick: UntilTick = None
) -> Response:
    """What a character did of late, or before a tick, as MP4; rendered on request, which takes a while."""
    session = core.character(str(character_id))
    now = session.state.tick
    stop = min(now if until_tick is None else until_tick, now) + 1
    first = max(0, stop - round(seconds * TICK_HZ))
    captions = [] if session.command.text is None else [(first, session.command.text)]
    request = Render(start_tick=first, stop_tick=stop, captions=captions)
    video = await session.loop.ask_tracker(Video, request, RENDER_TIMEOUT_S)
    headers = {"Content-Disposition": f'attachment; filename="{character_id}.mp4"'}
    return Response(np.asarray(video.mp4, dtype=np.uint8).tobytes(), media_type="video/mp4", headers=headers)
