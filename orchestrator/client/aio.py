"""The same client for asyncio: what `sync` has, with `await` and `async for`."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Mapping, Sequence
from contextlib import aclosing, suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self, TypeVar, Unpack

import httpx
from pydantic import BaseModel
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosedOK, InvalidHandshake, WebSocketException

from orchestrator.client import calls
from orchestrator.client.calls import Address, Call, CharacterOptions, CommandOptions, EpisodeOptions, Format
from orchestrator.client.errors import ServerProblem, no_connection, problem_of, usable_proxies
from orchestrator.client.models import CharacterInfo, CommandTaken, EpisodeInfo, PlanGhost, State, event_of, message_of
from orchestrator.client.motion import Motion
from orchestrator.client.sync import QUIET_S
from orchestrator.rest import Event, ObjectState, ServiceInfo, ServicesHealth, ServicesInfo
from shared.errors import ConflictError, DeadlineError, MotionLoopError

T = TypeVar("T")


class AsyncClient:
    """See `Client`."""

    def __init__(self, url: str | None = None, token: str | None = None, timeout_s: float = calls.TIMEOUT_S):
        self.address = Address.find(url, token)
        address = self.address
        with usable_proxies():
            self._http = httpx.AsyncClient(
                base_url=address.url, headers=address.headers, timeout=timeout_s, trust_env=address.by_proxy
            )

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def close(self) -> None:
        """Close the connections. Characters go on living on the server."""
        await self._http.aclose()

    async def character(self, **options: Unpack[CharacterOptions]) -> AsyncCharacter:
        """Make a character that stands and waits for commands."""
        return AsyncCharacter(self, (await self.do(calls.create_character(options))).id)

    @property
    def characters(self) -> AsyncCharacters:
        """Those there are."""
        return AsyncCharacters(self)

    async def episode(
        self, tasks: Sequence[Mapping[str, Any] | BaseModel], **options: Unpack[EpisodeOptions]
    ) -> AsyncEpisode:
        """Start an episode of tasks."""
        return AsyncEpisode(self, await self.do(calls.start_episode(tasks, options)))

    @property
    def episodes(self) -> AsyncEpisodes:
        """Those there are, running or over."""
        return AsyncEpisodes(self)

    async def services(self) -> ServicesInfo:
        """What planner and tracker are in use."""
        return await self.do(calls.services())

    async def swap(
        self, kind: calls.ServiceKind, plugin: str | None = None, *, endpoint: str | None = None
    ) -> ServiceInfo:
        """Exchange the planner or the tracker while everything goes on."""
        return await self.do(calls.swap(kind, plugin, endpoint))

    async def health(self) -> ServicesHealth:
        """How planner and tracker are: times, counts, or why one is away."""
        return await self.do(calls.health())

    async def ready(self) -> bool:
        """Whether the server and both services answer."""
        try:
            await self.do(calls.ready())
        except MotionLoopError as error:
            if error.retryable:
                return False
            raise
        return True

    async def do(self, call: Call[T]) -> T:
        """Send one request and read its reply."""
        timeout = httpx.USE_CLIENT_DEFAULT if call.timeout_s is None else call.timeout_s
        try:
            response = await self._http.request(
                call.method, call.path, json=call.body, params=dict(call.query), timeout=timeout
            )  # fmt: skip
        except httpx.TransportError as error:
            raise no_connection(self.address.url, error) from error
        if not response.is_success:
            raise problem_of(response.status_code, response.content)
        return call.read(response.content)

    async def event_lines(self, path: str, timeout_s: float) -> AsyncGenerator[str, None]:
        """Lines of a stream of server-sent events; DeadlineError when none comes for `timeout_s`."""
        try:
            async with self._http.stream("GET", path, timeout=timeout_s) as response:
                if not response.is_success:
                    raise problem_of(response.status_code, await response.aread())
                async for line in response.aiter_lines():
                    yield line
        except httpx.TransportError as error:
            raise no_connection(self.address.url, error) from error


class AsyncCharacter:
    """See `Character`."""

    def __init__(self, client: AsyncClient, character_id: str):
        self._client = client
        self.id = character_id

    def __repr__(self) -> str:
        return f"AsyncCharacter({self.id!r})"

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def info(self) -> CharacterInfo:
        """What it is, what it was told, how it is."""
        return await self._client.do(calls.get_character(self.id))

    async def state(self) -> State:
        """How it is now."""
        return (await self.info()).now()

    async def say(self, text: str | None = None, **options: Unpack[CommandOptions]) -> int:
        """Tell it what to do; returns the tick at which the command was taken."""
        return (await self.tell(text, **options)).tick

    async def tell(self, text: str | None = None, **options: Unpack[CommandOptions]) -> CommandTaken:
        """As `say`; returns how the command was understood too."""
        return await self._client.do(calls.command(self.id, text, options))

    async def push(self, body: str, impulse_ns: Sequence[float]) -> State:
        """Push a body: newton seconds in the world frame."""
        return await self._client.do(calls.push(self.id, body, impulse_ns))

    async def objects(self) -> dict[str, ObjectState]:
        """The objects of its scene by name, now."""
        return await self._client.do(calls.objects(self.id))

    async def move_object(self, name: str, **options: Unpack[calls.ObjectOptions]) -> ObjectState:
        """Put an object somewhere, and give it a velocity."""
        return await self._client.do(calls.move_object(self.id, name, options))

    async def pause(self) -> State:
        """Stop its clock."""
        return await self._client.do(calls.act(self.id, "pause"))

    async def resume(self) -> State:
        """Let its clock run again."""
        return await self._client.do(calls.act(self.id, "resume"))

    async def reset(self) -> State:
        """Stand it up where it is."""
        return await self._client.do(calls.act(self.id, "reset"))

    async def step(self, ticks: int = 30) -> State:
        """Let a lockstep character, or a paused one, go on for some ticks."""
        return await self._client.do(calls.step(self.id, ticks))

    async def close(self) -> None:
        """End it; one that is gone already is fine."""
        try:
            await self._client.do(calls.delete_character(self.id))
        except ServerProblem as problem:
            if problem.code != "not_found":
                raise

    async def watch(
        self, timeout_s: float | None = None, past_events: int | None = None
    ) -> AsyncGenerator[State | PlanGhost | Event, None]:
        """States, plans and events as they come, until the character ends; see `Character.watch`."""
        address = self._client.address
        try:
            async with connect(
                address.stream_url(self.id, past_events), additional_headers=address.headers, proxy=None,
                open_timeout=calls.TIMEOUT_S, max_size=None,
            ) as socket:  # fmt: skip
                while True:
                    async with asyncio.timeout(timeout_s):
                        message = await socket.recv()
                    yield message_of(message)
        except ConnectionClosedOK:
            return
        except InvalidHandshake as error:
            await self.info()  # says better what is wrong
            raise no_connection(address.url, error) from error
        except (OSError, WebSocketException) as error:
            raise no_connection(address.url, error) from error

    async def stream(self, timeout_s: float | None = None) -> AsyncGenerator[State, None]:
        """Its states, 30 a second in realtime, always the newest."""
        async with aclosing(self.watch(timeout_s, 0)) as messages:
            async for message in messages:
                if isinstance(message, State):
                    yield message

    async def events(self, timeout_s: float | None = None) -> AsyncGenerator[Event, None]:
        """What happened to it so far, and then what happens."""
        async with aclosing(self.watch(timeout_s)) as messages:
            async for message in messages:
                if isinstance(message, Event):
                    yield message

    async def wait_for(self, condition: Callable[[State], bool], timeout_s: float = 60.0) -> State:
        """The first state for which the condition holds; DeadlineError when there is none in time."""
        until = time.monotonic() + timeout_s
        with suppress(DeadlineError):  # no state at all is no fulfilled condition either
            async with aclosing(self.stream(timeout_s)) as states:
                async for state in states:
                    if condition(state):
                        return state
                    if time.monotonic() > until:
                        break
        raise DeadlineError(f"the condition did not hold within {timeout_s:g} s")

    async def motion(self, seconds: float = 60.0) -> Motion:
        """What it did of late."""
        return await self._client.do(calls.motion("characters", self.id, seconds))

    async def save(self, path: str | Path, seconds: float = 60.0, unit: Literal["m", "cm"] = "m") -> Path:
        """What it did of late as a file; see `Character.save`."""
        kind = calls.format_of(path)
        return await _written(path, await self._client.do(calls.export("characters", self.id, kind, unit, seconds)))


class AsyncCharacters:
    """The characters on a server: `await characters.get(id)`, `async for`, `await characters.all()`."""

    def __init__(self, client: AsyncClient):
        self._client = client

    async def get(self, character_id: str) -> AsyncCharacter:
        """A living one; raises ServerProblem with code `not_found`."""
        return AsyncCharacter(self._client, (await self._client.do(calls.get_character(character_id))).id)

    async def all(self) -> list[CharacterInfo]:
        """What they are and how, oldest first."""
        return await self._client.do(calls.list_characters())

    async def __aiter__(self) -> AsyncIterator[AsyncCharacter]:
        for info in await self.all():
            yield AsyncCharacter(self._client, info.id)


class AsyncEpisode:
    """See `Episode`."""

    def __init__(self, client: AsyncClient, episode_id: str):
        self._client = client
        self.id = episode_id
        self._result: EpisodeInfo | None = None

    def __repr__(self) -> str:
        return f"AsyncEpisode({self.id!r})"

    async def info(self) -> EpisodeInfo:
        """As it is now."""
        return await self._client.do(calls.get_episode(self.id))

    async def events(self, since: int = 0, timeout_s: float = QUIET_S) -> AsyncGenerator[Event, None]:
        """What happened so far, then what happens until it ends; DeadlineError when nothing does for `timeout_s`."""
        async with aclosing(self._client.event_lines(calls.events_path(self.id, since), timeout_s)) as lines:
            async for line in lines:
                event = event_of(line)
                if event is not None:
                    yield event

    async def wait(
        self, timeout_s: float | None = None, on_event: Callable[[Event], None] | None = None
    ) -> EpisodeInfo:
        """Wait until it is over; see `Episode.wait`."""
        seen = 0
        try:
            async with asyncio.timeout(timeout_s):
                while self._result is None:
                    try:
                        async with aclosing(self.events(seen)) as events:
                            async for event in events:
                                seen = event.seq
                                if on_event is not None:
                                    on_event(event)
                    except DeadlineError:
                        pass  # silence: whether it is over is looked at below
                    info = await self.info()
                    if info.status != "running":
                        self._result = info
        except TimeoutError as error:
            message = f"the episode still runs after {timeout_s:g} s: wait again, or cancel() it"
            raise DeadlineError(message) from error
        return self._result

    @property
    def result(self) -> EpisodeInfo:
        """What `wait` found; raises ConflictError before."""
        if self._result is None:
            raise ConflictError("how the episode ended is known after wait()", field="result")
        return self._result

    async def skip(self) -> int:
        """End the task being performed, as failed, and go on with the next; returns its index."""
        return await self._client.do(calls.skip_task(self.id))

    async def insert(self, task: Mapping[str, Any] | BaseModel, place: int = 0) -> int:
        """Add a task before what is `place`-th to come (0: next); returns its index."""
        return await self._client.do(calls.insert_task(self.id, task, place))

    async def cancel(self) -> None:
        """End it now; what was recorded stays. Nothing happens to one that is over."""
        if (await self.info()).status == "running":
            await self._client.do(calls.delete_episode(self.id))

    async def delete(self) -> None:
        """Remove it and its recording; raises ConflictError while it runs."""
        if (await self.info()).status == "running":
            raise ConflictError("the episode still runs: cancel() it first", field="status")
        await self._client.do(calls.delete_episode(self.id))

    async def motion(self) -> Motion:
        """What was recorded, as arrays."""
        return await self._client.do(calls.motion("episodes", self.id))

    async def export(self, kind: Format, unit: Literal["m", "cm"] = "m") -> bytes:
        """What was recorded, as the bytes of a file; `unit` counts for BVH."""
        return await self._client.do(calls.export("episodes", self.id, kind, unit))

    async def save(self, path: str | Path, unit: Literal["m", "cm"] = "m") -> Path:
        """What was recorded, as a file; see `Episode.save`."""
        return await _written(path, await self.export(calls.format_of(path), unit))


class AsyncEpisodes:
    """The episodes on a server: `await episodes.get(id)`, `await episodes.all()`."""

    def __init__(self, client: AsyncClient):
        self._client = client

    async def get(self, episode_id: str) -> AsyncEpisode:
        """One, running or over; raises ServerProblem with code `not_found`."""
        return AsyncEpisode(self._client, (await self._client.do(calls.get_episode(episode_id))).id)

    async def all(self, status: str | None = None, limit: int = 50, offset: int = 0) -> list[EpisodeInfo]:
        """A page of them, newest first."""
        return await self._client.do(calls.list_episodes(status, limit, offset))


async def _written(path: str | Path, data: bytes) -> Path:
    file = Path(path)
    await asyncio.to_thread(file.parent.mkdir, parents=True, exist_ok=True)
    await asyncio.to_thread(file.write_bytes, data)
    return file
