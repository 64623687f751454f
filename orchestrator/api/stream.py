"""WebSockets that show a character or a running episode as it happens.

`format=json` (the default) sends {"type": "state" | "event" | "plan", ...} as text. `format=binary` sends states and
plans as blocks of orchestrator/api/binary.py and events as text; its viewer acknowledges every state by sending the
state's `tick` back as text, and the server has at most `STATES_UNDER_WAY` of them on the line. Either way a viewer that
is slow skips states: it is always sent the newest and nothing is queued for it. Events are not skipped.
"""

from __future__ import annotations

import asyncio
import base64
import binascii
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from fastapi import APIRouter, Query, WebSocket, WebSocketDisconnect

from orchestrator.api.access import check_access, of_another_origin
from orchestrator.api.binary import pack
from orchestrator.api.models import StateBody
from orchestrator.core.events import EventLog
from orchestrator.core.fanout import Fanout
from orchestrator.core.loop import CharacterLoop
from orchestrator.core.manager import Orchestrator
from orchestrator.rest import Event
from shared.errors import NotFoundError
from shared.motion.kinematics import forward_kinematics
from shared.motion.rotations import matrix_from_6d, quat_from_matrix
from shared.motion.skeleton import CANONICAL
from shared.protocol.messages import Plan, StateFrame

router = APIRouter(tags=["streams"])

STATES_UNDER_WAY = 4
PROTOCOL = "motionloop"
TOKEN_PREFIX = "bearer."
KEPT_STILL_S = 1.0
"""A state that shows nothing new (the clock is paused) is repeated only so often."""
NOT_FOUND, FORBIDDEN = 4404, 4403

Format = Literal["json", "binary"]
Since = Annotated[int, Query(ge=0)]
Tail = Annotated[int | None, Query(ge=0, le=2000)]


@dataclass(frozen=True)
class Watched:
    """What a viewer sees: the newest states, the events, the plans of the loop, and (status, why)."""

    states: Fanout[StateFrame]
    events: EventLog
    loop: CharacterLoop
    status: Callable[[], tuple[str, str | None]]


def watched_character(core: Orchestrator, character_id: str) -> Watched:
    """A commanded character; raises NotFoundError."""
    session = core.character(character_id)
    return Watched(session.states, session.events, session.loop, lambda: (session.status, session.reason))


def watched_episode(core: Orchestrator, episode_id: str) -> Watched:
    """An episode that runs; raises NotFoundError for one that is over."""
    live = core.live_episode(episode_id)
    if live is None or live.outcome is not None:
        raise NotFoundError(f"no episode {episode_id} is running", field="id")
    session = live.runner.session
    return Watched(session.states, session.events, session.loop, lambda: (str(live.runner.phase), None))


@router.websocket("/v1/characters/{item_id}/stream")
async def character_stream(
    socket: WebSocket, item_id: str, format: Format = "json", since: Since = 0, tail: Tail = None
) -> None:
    """States, plans and events of a character; `since` and `tail` say which past events come first."""
    await _serve(socket, watched_character, item_id, format, since, tail)


@router.websocket("/v1/episodes/{item_id}/stream")
async def episode_stream(
    socket: WebSocket, item_id: str, format: Format = "json", since: Since = 0, tail: Tail = None
) -> None:
    """The same of a running episode; the socket closes when it ends."""
    await _serve(socket, watched_episode, item_id, format, since, tail)


def state_block(state: StateFrame, status: str, reason: str | None) -> bytes:
    """A state as a block: joints in the skeleton's order, metres and wxyz quaternions, world frame.

    `server_s` is the server's monotonic clock, so that a viewer can tell a slow simulation from a slow connection.
    """
    header = {
        "type": "state",
        "tick": state.tick,
        "time_s": state.time_s,
        "server_s": round(time.monotonic(), 4),
        "paused": state.paused,
        "status": status,
        "reason": reason,
        "tracker": state.tracker,
        "tracking_error_m": round(state.tracking_error_m, 5),
        "fallen": state.fallen,
        "contacts": [bool(c) for c in np.asarray(state.contacts)],
        "plan_end_tick": state.plan_end_tick,
        "missed_ticks": state.missed_ticks,
        "failure": state.failure,
        "objects": state.objects,
    }
    arrays = {
        "positions_m": state.body_pos_w_m,
        "rotations_wxyz": state.body_quat_w,
        "reference_m": state.reference_pos_w_m,
        "object_positions_m": state.object_pos_w_m,
        "object_rotations_wxyz": state.object_quat_w,
    }
    return pack(header, arrays)


def plan_block(plan: Plan) -> bytes:
    """A plan as a block; its local rotations become world ones, so that a viewer needs no kinematics."""
    positions = np.asarray(plan.positions_w_m, dtype=np.float64)
    _, world = forward_kinematics(CANONICAL, positions[:, 0], matrix_from_6d(plan.rotations_6d))
    header = {"type": "plan", "start_tick": plan.start_tick, "fps": plan.fps, "planner": plan.planner}
    return pack(header, {"positions_m": positions, "rotations_wxyz": quat_from_matrix(world)})


class _Viewer:
    """One socket: what was sent to it, and how much of it has arrived."""

    def __init__(self, socket: WebSocket, watched: Watched, binary: bool):
        self._socket = socket
        self._watched = watched
        self._binary = binary
        self._sending = asyncio.Lock()
        self._room = asyncio.Semaphore(STATES_UNDER_WAY)

    async def send_states(self) -> None:
        """Plans as they come and the newest state whenever there is room for one."""
        shown: tuple[Any, ...] | None = None
        shown_plan: Plan | None = None
        last_s = 0.0
        clock = asyncio.get_running_loop().time
        async for state in self._watched.states.listen():
            plan = self._watched.loop.last_plan
            if plan is not None and plan is not shown_plan:
                shown_plan = plan
                await self._send(plan_block(plan) if self._binary else _plan_message(plan))
            status, reason = self._watched.status()
            look = (state.tick, state.paused, state.fallen, status, reason, state.tracker)
            if look == shown and clock() - last_s < KEPT_STILL_S:
                continue
            shown, last_s = look, clock()
            if self._binary:
                await self._room.acquire()
                await self._send(state_block(state, status, reason))
            else:
                await self._send({"type": "state", **StateBody.of(state).model_dump(mode="json")})

    async def send_events(self, since: int) -> None:
        """Events in order."""
        async for event in self._watched.events.listen(since):
            await self._send({"type": "event", "event": event.model_dump(mode="json")})

    async def receive(self) -> None:
        """Acknowledgements, until the viewer goes."""
        try:
            while True:
                await self._socket.receive_text()
                if self._binary:
                    self._room.release()
        except WebSocketDisconnect:
            return

    async def _send(self, message: bytes | dict[str, Any]) -> None:
        async with self._sending:
            if isinstance(message, bytes):
                await self._socket.send_bytes(message)
            else:
                await self._socket.send_json(message)


async def _serve(
    socket: WebSocket,
    find: Callable[[Orchestrator, str], Watched],
    item_id: str,
    format: Format,
    since: int,
    tail: int | None,
) -> None:
    offered = _admit(socket)
    if offered is None:
        await socket.close(FORBIDDEN, "this page may not watch")
        return
    core: Orchestrator = socket.app.state.orchestrator
    try:
        watched = find(core, item_id)
    except NotFoundError as error:
        await socket.close(NOT_FOUND, error.message)
        return
    await socket.accept(PROTOCOL if PROTOCOL in offered else None)
    viewer = _Viewer(socket, watched, format == "binary")
    tasks = [
        asyncio.create_task(viewer.send_states()),
        asyncio.create_task(viewer.send_events(first_event(watched.events.since(since), since, tail))),
        asyncio.create_task(viewer.receive()),
    ]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        # An ended episode closes states and events together: let the last event out before the socket closes.
        if tasks[0].done() and not tasks[2].done():
            await asyncio.wait(tasks[1:], return_when=asyncio.FIRST_COMPLETED, timeout=5.0)
        if not tasks[2].done():
            await socket.close()
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


def first_event(kept: list[Event], since: int, tail: int | None) -> int:
    """The number after which events are sent, so that at most `tail` of those kept come first."""
    if tail is None or len(kept) <= tail:
        return since
    return kept[-tail - 1].seq


def _admit(socket: WebSocket) -> list[str] | None:
    """The offered subprotocols of a viewer that may watch, else None. Raises 401 as the other routes do.

    A browser can neither set a header on a WebSocket nor is it kept from opening one to another site. So the token may
    also come as a subprotocol (`bearer.` and the token in base64url), and a page of another origin is turned away.
    """
    offered = [part.strip() for part in socket.headers.get("sec-websocket-protocol", "").split(",") if part.strip()]
    if of_another_origin(socket):
        return None
    check_access(socket, [_token(part) for part in offered if part.startswith(TOKEN_PREFIX)])
    return offered


def _token(part: str) -> bytes:
    text = part.removeprefix(TOKEN_PREFIX)
    try:
        return base64.urlsafe_b64decode(text + "=" * (-len(text) % 4))
    except (binascii.Error, ValueError):
        return b""


def _plan_message(plan: Plan) -> dict[str, Any]:
    positions = np.asarray(plan.positions_w_m, dtype=np.float64).round(3).tolist()
    return {"type": "plan", "start_tick": plan.start_tick, "fps": plan.fps, "positions_m": positions}
