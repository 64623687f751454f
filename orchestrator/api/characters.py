"""/v1/characters: make, command, push, watch."""

from __future__ import annotations

import asyncio
from typing import Annotated, Any

from fastapi import APIRouter, Body, Response, WebSocket, WebSocketDisconnect

from orchestrator.api.deps import CharacterId, Core, check_token
from orchestrator.api.models import (
    CharacterBody,
    CharacterList,
    CommandAccepted,
    ImpulseBody,
    StateBody,
    StepBody,
)
from orchestrator.api.problems import RESPONSES
from orchestrator.core.character import CharacterSession, CharacterSpec
from orchestrator.core.command import Command
from orchestrator.core.manager import Orchestrator
from shared.errors import NotFoundError

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
    """Tell it what to do; the last command holds until the next."""
    tick = core.character(str(character_id)).set_command(body)
    return CommandAccepted(tick=tick, command=body)


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
    """Let a lockstep character go on for some ticks, planning on the way."""
    return StateBody.of(await core.character(str(character_id)).advance(body.ticks))


@router.websocket("/{character_id}/stream")
async def stream(socket: WebSocket, character_id: str) -> None:
    """State and events as JSON: {"type": "state" | "event" | "plan", ...}; slow readers skip states, not events."""
    check_token(socket)
    core: Orchestrator = socket.app.state.orchestrator
    try:
        session = core.character(character_id)
    except NotFoundError as error:
        await socket.close(4404, error.message)
        return
    await socket.accept()
    sending = asyncio.Lock()
    tasks = [
        asyncio.create_task(_send_states(socket, session, sending)),
        asyncio.create_task(_send_events(socket, session, sending)),
        asyncio.create_task(_wait_for_end(socket)),
    ]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def _send_states(socket: WebSocket, session: CharacterSession, sending: asyncio.Lock) -> None:
    ghost = -1
    async for state in session.states.listen():
        plan = session.loop.last_plan
        if plan is not None and plan.start_tick != ghost:
            ghost = plan.start_tick
            message = {
                "type": "plan",
                "start_tick": ghost,
                "fps": plan.fps,
                "positions_m": _rounded(plan.positions_w_m),
            }
            async with sending:
                await socket.send_json(message)
        async with sending:
            await socket.send_json({"type": "state", **StateBody.of(state).model_dump(mode="json")})


async def _send_events(socket: WebSocket, session: CharacterSession, sending: asyncio.Lock) -> None:
    async for event in session.events.listen():
        async with sending:
            await socket.send_json({"type": "event", "event": event.model_dump(mode="json")})


async def _wait_for_end(socket: WebSocket) -> None:
    try:
        while True:
            await socket.receive_text()
    except WebSocketDisconnect:
        return


def _rounded(array: Any) -> list[Any]:
    return [[[round(float(v), 3) for v in joint] for joint in frame] for frame in array]
