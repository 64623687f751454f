"""The blocking client."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self, TypeVar, Unpack

import httpx
from pydantic import BaseModel
from websockets.exceptions import ConnectionClosedOK, InvalidHandshake, WebSocketException
from websockets.sync.client import connect

from orchestrator.client import calls
from orchestrator.client.calls import Address, Call, CharacterOptions, CommandOptions, EpisodeOptions, Format
from orchestrator.client.errors import ServerProblem, no_connection, problem_of, usable_proxies
from orchestrator.client.models import CharacterInfo, CommandTaken, EpisodeInfo, PlanGhost, State, event_of, message_of
from orchestrator.client.motion import Motion
from orchestrator.rest import Event, ObjectState, ServiceInfo, ServicesHealth, ServicesInfo
from shared.errors import ConflictError, DeadlineError, MotionLoopError

T = TypeVar("T")
QUIET_S = 120.0
"""A running episode reports twice a simulated second; one that is silent for so long is looked at."""


class Client:
    """Makes and finds characters and episodes on a server; a context manager that closes its connections.

    Args:
        url: of the server; MOTIONLOOP_URL, else http://127.0.0.1:8080, when None.
        token: bearer token, where the server wants one; MOTIONLOOP_TOKEN when None.
        timeout_s: for one ordinary request.

    Every method raises ServerProblem for what the server refuses, UnavailableError or DeadlineError when it cannot be
    reached; all are MotionLoopError, with `code`, `field`, `allowed` and `retryable`.
    """

    def __init__(self, url: str | None = None, token: str | None = None, timeout_s: float = calls.TIMEOUT_S):
        self.address = Address.find(url, token)
        address = self.address
        with usable_proxies():
            self._http = httpx.Client(
                base_url=address.url, headers=address.headers, timeout=timeout_s, trust_env=address.by_proxy
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections. Characters go on living on the server."""
        self._http.close()

    def character(self, **options: Unpack[CharacterOptions]) -> Character:
        """Make a character that stands and waits for commands."""
        return Character(self, self.do(calls.create_character(options)).id)

    @property
    def characters(self) -> Characters:
        """Those there are."""
        return Characters(self)

    def episode(self, tasks: Sequence[Mapping[str, Any] | BaseModel], **options: Unpack[EpisodeOptions]) -> Episode:
        """Start an episode of tasks, e.g. `[{"type": "reach", "relative_m": [2, 0]}, {"type": "halt"}]`."""
        return Episode(self, self.do(calls.start_episode(tasks, options)))

    @property
    def episodes(self) -> Episodes:
        """Those there are, running or over."""
        return Episodes(self)

    def services(self) -> ServicesInfo:
        """What planner and tracker are in use."""
        return self.do(calls.services())

    def swap(self, kind: calls.ServiceKind, plugin: str | None = None, *, endpoint: str | None = None) -> ServiceInfo:
        """Exchange the planner or the tracker while everything goes on: another plug-in, another service, or both."""
        return self.do(calls.swap(kind, plugin, endpoint))

    def health(self) -> ServicesHealth:
        """How planner and tracker are: times, counts, or why one is away."""
        return self.do(calls.health())

    def ready(self) -> bool:
        """Whether the server and both services answer."""
        try:
            self.do(calls.ready())
        except MotionLoopError as error:
            if error.retryable:
                return False
            raise
        return True

    def do(self, call: Call[T]) -> T:
        """Send one request and read its reply."""
        timeout = httpx.USE_CLIENT_DEFAULT if call.timeout_s is None else call.timeout_s
        try:
            response = self._http.request(
                call.method, call.path, json=call.body, params=dict(call.query), timeout=timeout
            )  # fmt: skip
        except httpx.TransportError as error:
            raise no_connection(self.address.url, error) from error
        if not response.is_success:
            raise problem_of(response.status_code, response.content)
        return call.read(response.content)

    def event_lines(self, path: str, timeout_s: float) -> Iterator[str]:
        """Lines of a stream of server-sent events; DeadlineError when none comes for `timeout_s`."""
        try:
            with self._http.stream("GET", path, timeout=timeout_s) as response:
                if not response.is_success:
                    raise problem_of(response.status_code, response.read())
                yield from response.iter_lines()
        except httpx.TransportError as error:
            raise no_connection(self.address.url, error) from error


class Character:
    """A character on the server. As a context manager it is ended on leaving; otherwise it goes on living."""

    def __init__(self, client: Client, character_id: str):
        self._client = client
        self.id = character_id

    def __repr__(self) -> str:
        return f"Character({self.id!r})"

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def info(self) -> CharacterInfo:
        """What it is, what it was told, how it is."""
        return self._client.do(calls.get_character(self.id))

    def state(self) -> State:
        """How it is now."""
        return self.info().now()

    def say(self, text: str | None = None, **options: Unpack[CommandOptions]) -> int:
        """Tell it what to do, in words, by a target, or both; it holds until the next command.

        Returns the tick at which the command was taken. Options: see CommandOptions.
        """
        return self.tell(text, **options).tick

    def tell(self, text: str | None = None, **options: Unpack[CommandOptions]) -> CommandTaken:
        """As `say`; returns how the command was understood too."""
        return self._client.do(calls.command(self.id, text, options))

    def push(self, body: str, impulse_ns: Sequence[float]) -> State:
        """Push a body, e.g. `push("spine3", (0, 30, 0))`: newton seconds in the world frame."""
        return self._client.do(calls.push(self.id, body, impulse_ns))

    def objects(self) -> dict[str, ObjectState]:
        """The objects of its scene by name, now."""
        return self._client.do(calls.objects(self.id))

    def move_object(self, name: str, **options: Unpack[calls.ObjectOptions]) -> ObjectState:
        """Put an object somewhere, e.g. `move_object("ball", position_m=(2, 0, 1), velocity_mps=(-6, 0, 2))`."""
        return self._client.do(calls.move_object(self.id, name, options))

    def pause(self) -> State:
        """Stop its clock."""
        return self._client.do(calls.act(self.id, "pause"))

    def resume(self) -> State:
        """Let its clock run again."""
        return self._client.do(calls.act(self.id, "resume"))

    def reset(self) -> State:
        """Stand it up where it is."""
        return self._client.do(calls.act(self.id, "reset"))

    def step(self, ticks: int = 30) -> State:
        """Let a lockstep character, or a paused one, go on for some ticks."""
        return self._client.do(calls.step(self.id, ticks))

    def close(self) -> None:
        """End it; one that is gone already is fine."""
        try:
            self._client.do(calls.delete_character(self.id))
        except ServerProblem as problem:
            if problem.code != "not_found":
                raise

    def watch(
        self, timeout_s: float | None = None, past_events: int | None = None
    ) -> Iterator[State | PlanGhost | Event]:
        """States, plans and events as they come, until the character ends. A slow reader skips states, not events.

        Args:
            timeout_s: raise DeadlineError when nothing comes for so long; None waits.
            past_events: how many of the events so far come first; None for all that are kept.
        """
        address = self._client.address
        try:
            with connect(
                address.stream_url(self.id, past_events), additional_headers=address.headers, proxy=None,
                open_timeout=calls.TIMEOUT_S, max_size=None,
            ) as socket:  # fmt: skip
                while True:
                    yield message_of(socket.recv(timeout_s))
        except ConnectionClosedOK:
            return
        except InvalidHandshake as error:
            self.info()  # says better what is wrong
            raise no_connection(address.url, error) from error
        except (OSError, WebSocketException) as error:
            raise no_connection(address.url, error) from error

    def stream(self, timeout_s: float | None = None) -> Iterator[State]:
        """Its states, 30 a second in realtime, always the newest."""
        return (message for message in self.watch(timeout_s, 0) if isinstance(message, State))

    def events(self, timeout_s: float | None = None) -> Iterator[Event]:
        """What happened to it so far, and then what happens."""
        return (message for message in self.watch(timeout_s) if isinstance(message, Event))

    def wait_for(self, condition: Callable[[State], bool], timeout_s: float = 60.0) -> State:
        """The first state for which the condition holds; DeadlineError when there is none in time."""
        until = time.monotonic() + timeout_s
        with suppress(DeadlineError):  # no state at all is no fulfilled condition either
            for state in self.stream(timeout_s):
                if condition(state):
                    return state
                if time.monotonic() > until:
                    break
        raise DeadlineError(f"the condition did not hold within {timeout_s:g} s")

    def motion(self, seconds: float = 60.0) -> Motion:
        """What it did of late."""
        return self._client.do(calls.motion("characters", self.id, seconds))

    def save(self, path: str | Path, seconds: float = 60.0, unit: Literal["m", "cm"] = "m") -> Path:
        """What it did of late as a file: .npz, .bvh, .csv, .glb or .mp4 by the ending of the name."""
        data = self._client.do(calls.export("characters", self.id, calls.format_of(path), unit, seconds))
        return _written(path, data)


class Characters:
    """The characters on a server: `characters[id]`, `characters.get(id)`, iteration, `len`."""

    def __init__(self, client: Client):
        self._client = client

    def get(self, character_id: str) -> Character:
        """A living one; raises ServerProblem with code `not_found`."""
        return Character(self._client, self._client.do(calls.get_character(character_id)).id)

    __getitem__ = get

    def all(self) -> list[CharacterInfo]:
        """What they are and how, oldest first."""
        return self._client.do(calls.list_characters())

    def __iter__(self) -> Iterator[Character]:
        return iter([Character(self._client, info.id) for info in self.all()])

    def __len__(self) -> int:
        return len(self.all())


class Episode:
    """An episode on the server."""

    def __init__(self, client: Client, episode_id: str):
        self._client = client
        self.id = episode_id
        self._result: EpisodeInfo | None = None

    def __repr__(self) -> str:
        return f"Episode({self.id!r})"

    def info(self) -> EpisodeInfo:
        """As it is now."""
        return self._client.do(calls.get_episode(self.id))

    def events(self, since: int = 0, timeout_s: float = QUIET_S) -> Iterator[Event]:
        """What happened so far, then what happens until it ends; DeadlineError when nothing does for `timeout_s`."""
        for line in self._client.event_lines(calls.events_path(self.id, since), timeout_s):
            event = event_of(line)
            if event is not None:
                yield event

    def wait(self, timeout_s: float | None = None, on_event: Callable[[Event], None] | None = None) -> EpisodeInfo:
        """Wait until it is over; returns what became of it.

        Args:
            timeout_s: raise DeadlineError after so long; the episode itself goes on.
            on_event: told of every event.
        """
        until = None if timeout_s is None else time.monotonic() + timeout_s
        seen = 0
        while self._result is None:
            left = QUIET_S if until is None else min(QUIET_S, max(until - time.monotonic(), 0.01))
            try:
                for event in self.events(seen, left):
                    seen = event.seq
                    if on_event is not None:
                        on_event(event)
                    if until is not None and time.monotonic() > until:
                        break
            except DeadlineError:
                pass  # silence: whether it is over, and whether there is time left, is looked at below
            info = self.info()
            if info.status != "running":
                self._result = info
            elif until is not None and time.monotonic() > until:
                raise DeadlineError(f"the episode still runs after {timeout_s:g} s: wait again, or cancel() it")
        return self._result

    @property
    def result(self) -> EpisodeInfo:
        """What `wait` found; raises ConflictError before."""
        if self._result is None:
            raise ConflictError("how the episode ended is known after wait()", field="result")
        return self._result

    def skip(self) -> int:
        """End the task being performed, as failed, and go on with the next; returns its index."""
        return self._client.do(calls.skip_task(self.id))

    def insert(self, task: Mapping[str, Any] | BaseModel, place: int = 0) -> int:
        """Add a task before what is `place`-th to come (0: next); returns its index."""
        return self._client.do(calls.insert_task(self.id, task, place))

    def cancel(self) -> None:
        """End it now; what was recorded stays. Nothing happens to one that is over."""
        if self.info().status == "running":
            self._client.do(calls.delete_episode(self.id))

    def delete(self) -> None:
        """Remove it and its recording; raises ConflictError while it runs."""
        if self.info().status == "running":
            raise ConflictError("the episode still runs: cancel() it first", field="status")
        self._client.do(calls.delete_episode(self.id))

    def motion(self) -> Motion:
        """What was recorded, as arrays."""
        return self._client.do(calls.motion("episodes", self.id))

    def export(self, kind: Format, unit: Literal["m", "cm"] = "m") -> bytes:
        """What was recorded, as the bytes of a file; `unit` counts for BVH."""
        return self._client.do(calls.export("episodes", self.id, kind, unit))

    def save(self, path: str | Path, unit: Literal["m", "cm"] = "m") -> Path:
        """What was recorded, as a file: .npz, .bvh, .csv, .glb or .mp4 by the ending of the name."""
        return _written(path, self.export(calls.format_of(path), unit))


class Episodes:
    """The episodes on a server: `episodes[id]`, `episodes.get(id)`, `episodes.all()`."""

    def __init__(self, client: Client):
        self._client = client

    def get(self, episode_id: str) -> Episode:
        """One, running or over; raises ServerProblem with code `not_found`."""
        return Episode(self._client, self._client.do(calls.get_episode(episode_id)).id)

    __getitem__ = get

    def all(self, status: str | None = None, limit: int = 50, offset: int = 0) -> list[EpisodeInfo]:
        """A page of them, newest first; `status`: running, finished, failed, cancelled or interrupted."""
        return self._client.do(calls.list_episodes(status, limit, offset))


def _written(path: str | Path, data: bytes) -> Path:
    file = Path(path)
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(data)
    return file
