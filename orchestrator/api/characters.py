"""/v1/characters: make, command, push, step."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Body, Response

from orchestrator.api.deps import CharacterId, Core
from orchestrator.api.models import (
    CharacterBody,
    CharacterList,
    CommandAccepted,
    ImpulseBody,
    StateBody,
    StepBody,
)
from orchestrator.api.problems import RESPONSES
from orchestrator.core.character import CharacterSpec
from orchestrator.core.command import Command

router = APIRouter(prefix="/v1/characters", tags=["characters"], responses=RESPONSES)

_CHARACTERS: dict[str, Any] = {
    "realtime": {"summary": "Runs by the clock", "value": {"pacing": "realtime", "scene": "flat"}},
    "lockstep": {"summary": "Advances when told", "value": {"pacing": "lockstep", "seed": 7, "tracker": "pd"}},
}
_COMMANDS: dict[str, Any] = {
    "text": {"summary": "Words", "value": {"text": "a person waves with the right hand."}},
    "walk": {
        "summary": "Go somewhere",
        "value": {"text": "a person is walking.", "target": {"joint": "traj", "position_m": [2.0, 0.5, 0.0]}},
    },
    "reach": {
        "summary": "A hand to a point",
        "value": {"text": "a person reaches out.", "target": {"joint": "right_wrist", "position_m": [0.5, -0.2, 1.2]}},
    },
    "velocity": {"summary": "Steer", "value": {"velocity_mps": [1.0, 0.0], "heading_rad": 0.0}},
}
_IMPULSES: dict[str, Any] = {"push": {"value": {"body": "spine3", "impulse_ns": [0.0, 30.0, 0.0]}}}


@router.post("", status_code=201)
async def create(core: Core, spec: Annotated[CharacterSpec, Body(openapi_examples=_CHARACTERS)]) -> CharacterBody:
    """Make a character that stands and waits for commands."""
    return CharacterBody.of(await core.create_character(spec))


@router.get("")
async def list_all(core: Core) -> CharacterList:
    """All characters."""
    return CharacterList(items=[CharacterBody.of(session) for session in core.characters.values()])


@router.get("/{character_id}")
async def get(core: Core, character_id: CharacterId) -> CharacterBody:
    """One character with its present state."""
    return CharacterBody.of(core.character(str(character_id)))


@router.delete("/{character_id}", status_code=204)
async def delete(core: Core, character_id: CharacterId) -> Response:
    """End a character."""
    await core.delete_character(str(character_id))
    return Response(status_code=204)


@router.post("/{character_id}/commands", status_code=202)
async def command(
    core: Core, character_id: CharacterId, body: Annotated[Command, Body(openapi_examples=_COMMANDS)]
) -> CommandAccepted:
    """Tell it what to do; the last command holds until the next. The reply says how it was understood."""
    session = core.character(str(character_id))
    tick = session.set_command(body)
    reading = await session.reading(body)
    return CommandAccepted(tick=tick, command=body, **dict(reading))


@router.post("/{character_id}/impulses", status_code=202)
async def impulse(
    core: Core, character_id: CharacterId, body: Annotated[ImpulseBody, Body(openapi_examples=_IMPULSES)]
) -> StateBody:
    """Push it."""
    session = core.character(str(character_id))
    await session.impulse(body.body, body.impulse_ns)
    return StateBody.of(session.state)


@router.post("/{character_id}/reset")
async def reset(core: Core, character_id: CharacterId) -> StateBody:
    """Stand it up where it is."""
    return StateBody.of(await core.character(str(character_id)).reset())


@router.post("/{character_id}/pause")
async def pause(core: Core, character_id: CharacterId) -> StateBody:
    """Stop its clock."""
    return StateBody.of(await core.character(str(character_id)).pause(True))


@router.post("/{character_id}/resume")
async def resume(core: Core, character_id: CharacterId) -> StateBody:
    """Let its clock run again."""
    return StateBody.of(await core.character(str(character_id)).pause(False))


@router.post("/{character_id}/steps")
async def steps(core: Core, character_id: CharacterId, body: StepBody) -> StateBody:
    """Let a lockstep character, or a realtime one that is paused, go on for some ticks, planning on the way."""
    return StateBody.of(await core.character(str(character_id)).advance(body.ticks))
