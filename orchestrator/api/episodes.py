"""/v1/episodes: run tasks, follow them, fetch what came of them."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Body, Query, Response
from fastapi.responses import StreamingResponse

from orchestrator.api.deps import Core, EpisodeId
from orchestrator.api.models import EpisodeBody, EpisodeCreated, EpisodeList, InsertBody, TaskChanged
from orchestrator.api.problems import RESPONSES
from orchestrator.core.episode_spec import EpisodeSpec
from orchestrator.core.manager import Orchestrator

router = APIRouter(prefix="/v1/episodes", tags=["episodes"], responses=RESPONSES)

_EPISODES: dict[str, Any] = {
    "tour": {
        "summary": "Walk, wave, walk back, stand",
        "value": {
            "seed": 1,
            "tasks": [
                {"type": "reach", "relative_m": [2.0, 0.0]},
                {"type": "text", "text": "a person waves with the right hand.", "duration_s": 5},
                {"type": "reach", "relative_m": [-2.0, 0.0]},
                {"type": "halt"},
            ],
        },
    }
}
_INSERTS: dict[str, Any] = {
    "next": {"summary": "As the next one", "value": {"task": {"type": "halt"}}},
    "later": {"summary": "After the next two", "value": {"task": {"type": "reach", "relative_m": [1, 0]}, "place": 2}},
}
Status = Literal["running", "finished", "failed", "cancelled", "interrupted"]


def _body(core: Orchestrator, row: dict[str, Any]) -> EpisodeBody:
    live = core.live_episode(row["id"])
    extra: dict[str, Any] = {}
    if live is not None and row["status"] == "running":
        extra = {"phase": live.runner.phase, "tick": live.runner.tick, "results": live.runner.results}
    outcome = row["outcome"]
    if outcome:
        extra = {"success": outcome["success"], "results": outcome["results"], "tick": outcome["ticks"]}
    return EpisodeBody.model_validate(
        {
            **{key: row[key] for key in ("id", "status", "reason", "spec", "created_s", "ended_s")},
            "services": row["services"] or {},
            "outcome": outcome or None,
            **extra,
        }
    )


@router.post("", status_code=201)
async def create(core: Core, spec: Annotated[EpisodeSpec, Body(openapi_examples=_EPISODES)]) -> EpisodeCreated:
    """Start an episode."""
    return EpisodeCreated(id=core.start_episode(spec))


@router.get("")
async def list_all(
    core: Core,
    status: Status | None = None,
    limit: Annotated[int, Query(ge=1, le=200)] = 50,
    offset: Annotated[int, Query(ge=0, le=1_000_000)] = 0,
) -> EpisodeList:
    """Episodes, newest first."""
    rows, total = await core.reader.episodes(status, limit, offset)
    return EpisodeList(items=[_body(core, row) for row in rows], total=total, limit=limit, offset=offset)


@router.get("/{episode_id}")
async def get(core: Core, episode_id: EpisodeId) -> EpisodeBody:
    """One episode."""
    return _body(core, await core.reader.episode(str(episode_id)))


@router.delete("/{episode_id}")
async def delete(core: Core, episode_id: EpisodeId) -> dict[str, str]:
    """Cancel a running episode; delete one that is over, with its recording."""
    return {"status": await core.cancel_or_delete_episode(str(episode_id))}


@router.post("/{episode_id}/skip", status_code=202)
async def skip(core: Core, episode_id: EpisodeId) -> TaskChanged:
    """End the task being performed, as failed, and go on with the next."""
    runner = await core.running_episode(str(episode_id))
    return TaskChanged(index=runner.skip(), status="skipped")


@router.post("/{episode_id}/insert", status_code=202)
async def insert(
    core: Core, episode_id: EpisodeId, body: Annotated[InsertBody, Body(openapi_examples=_INSERTS)]
) -> TaskChanged:
    """Add a task to an episode that runs, by default as the next one."""
    runner = await core.running_episode(str(episode_id))
    return TaskChanged(index=runner.insert(body.task, body.place), status="inserted")


@router.get("/{episode_id}/events", response_class=StreamingResponse)
async def events(core: Core, episode_id: EpisodeId, since: Annotated[int, Query(ge=0)] = 0) -> StreamingResponse:
    """Server-sent events: those so far, then new ones until the episode ends."""
    await core.reader.episode(str(episode_id))
    return StreamingResponse(_sse(core, str(episode_id), since), media_type="text/event-stream")


async def _sse(core: Orchestrator, episode_id: str, since: int) -> AsyncIterator[str]:
    live = core.live_episode(episode_id)
    if live is None:
        for event in await core.reader.events(episode_id, since):
            yield f"id: {event.seq}\nevent: {event.type}\ndata: {event.model_dump_json()}\n\n"
        return
    async for event in live.runner.events.listen(since):
        yield f"id: {event.seq}\nevent: {event.type}\ndata: {event.model_dump_json()}\n\n"


@router.get("/{episode_id}/video.mp4", response_class=Response)
async def video(core: Core, episode_id: EpisodeId) -> Response:
    """The episode as MP4; rendered on the first request, which takes a while."""
    headers = {"Content-Disposition": f'attachment; filename="{episode_id}.mp4"'}
    return Response(await core.video(str(episode_id)), media_type="video/mp4", headers=headers)
