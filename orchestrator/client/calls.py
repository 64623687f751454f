"""Every request of the API as data: how it is asked and how its reply is read. The clients only send them."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, Literal, TypedDict, TypeVar, cast
from urllib.parse import urlsplit, urlunsplit

from pydantic import BaseModel, ValidationError

from orchestrator.client.models import CharacterInfo, CommandTaken, EpisodeInfo, State
from orchestrator.client.motion import Motion
from orchestrator.rest import ObjectState, ServiceInfo, ServicesHealth, ServicesInfo, StateFields
from shared.errors import InvalidInputError, MalformedMessageError
from shared.protocol.security import is_loopback

T = TypeVar("T")
M = TypeVar("M", bound=BaseModel)

DEFAULT_URL = "http://127.0.0.1:8080"
TIMEOUT_S = 60.0
VIDEO_TIMEOUT_S = 960.0
TRAJ = "traj"
"""The target joint that stands for the root on the floor."""

ServiceKind = Literal["planner", "tracker"]
Format = Literal["npz", "bvh", "csv", "glb", "mp4"]
FORMATS: tuple[Format, ...] = ("npz", "bvh", "csv", "glb", "mp4")


class CharacterOptions(TypedDict, total=False):
    """What a character can be made with; all optional.

    character: `human`, `child` (1.2 m) or `heavy` (1.9 m, 130 kg). scene: a name, or the scene itself (docs/scenes.md).
    pacing: `realtime` runs by the wall clock, `lockstep` when `step` is called. planner, tracker: plug-ins by name.
    on_fall: `stay`, `reset` (put on its feet) or `get_up`.
    """

    character: str
    scene: str | Mapping[str, Any]
    planner: str | None
    tracker: str | None
    pacing: Literal["realtime", "lockstep"]
    seed: int
    on_fall: Literal["stay", "reset", "get_up"]


class CommandOptions(TypedDict, total=False):
    """What a command can hold beside its text; all optional.

    target: where `joint` should go, metres in the world: (x, y, z), or (x, y) for `traj`, the root on the floor.
    heading_rad: which way to face, 0 along +X, anticlockwise. velocity_mps: (x, y). keyframes: poses to pass through,
    `{"in_s": 1.0, "positions_m": {"right_wrist": (x, y, z)}, "rotations_wxyz": {"head": (w, x, y, z)}}`.
    avoid: spheres to keep away from, `{"position_m": (x, y, z), "velocity_mps": (x, y, z), "radius_m": r}`.
    guidance: how strongly the text counts.
    replan: `now` plans at once, `next` with the next regular plan.
    """

    target: Sequence[float]
    joint: str
    heading_rad: float
    velocity_mps: Sequence[float]
    keyframes: Sequence[Mapping[str, Any]]
    avoid: Sequence[Mapping[str, Any]]
    guidance: float
    replan: Literal["now", "next"]


class ObjectOptions(TypedDict, total=False):
    """Where an object should be and how it should move; what is left out stays. World frame, metres, per second."""

    position_m: Sequence[float]
    rotation_wxyz: Sequence[float]
    velocity_mps: Sequence[float]
    angular_velocity_radps: Sequence[float]


class EpisodeOptions(TypedDict, total=False):
    """What an episode can be told beside its tasks; all optional, as `POST /v1/episodes` takes them."""

    name: str | None
    character: str
    scene: str | Mapping[str, Any]
    order: Literal["sequence", "random"]
    seed: int
    pacing: Literal["lockstep", "realtime"]
    on_fall: Literal["stay", "reset", "get_up"]
    time_limit_s: float | None
    planner: str | None
    tracker: str | None
    heading_rad: float


@dataclass(frozen=True)
class Call(Generic[T]):
    """One request and how to read its reply."""

    method: str
    path: str
    read: Callable[[bytes], T]
    body: Mapping[str, Any] | None = None
    query: Mapping[str, str] = field(default_factory=dict)
    timeout_s: float | None = None


@dataclass(frozen=True)
class Address:
    """Where the server is and how to be let in."""

    url: str
    token: str | None

    @classmethod
    def find(cls, url: str | None, token: str | None) -> Address:
        """What is given, else MOTIONLOOP_URL and MOTIONLOOP_TOKEN, else the server on this machine."""
        found = url or os.environ.get("MOTIONLOOP_URL") or DEFAULT_URL
        if urlsplit(found).scheme not in ("http", "https") or not urlsplit(found).netloc:
            raise InvalidInputError(f"{found!r} is no address of a server", field="url", allowed="http://HOST:PORT")
        return cls(found.rstrip("/"), token or os.environ.get("MOTIONLOOP_TOKEN") or None)

    @property
    def headers(self) -> dict[str, str]:
        """For every request."""
        return {"Authorization": f"Bearer {self.token}"} if self.token else {}

    @property
    def by_proxy(self) -> bool:
        """Whether the environment's proxies count: not for this machine, which no proxy can reach for us."""
        return not is_loopback(urlsplit(self.url).hostname or "")

    def stream_url(self, character_id: str, tail: int | None) -> str:
        """Of a character's WebSocket; `tail` limits how many past events come first."""
        scheme, netloc, path, _, _ = urlsplit(self.url)
        query = "" if tail is None else f"tail={tail}"
        swapped = "wss" if scheme == "https" else "ws"
        return urlunsplit((swapped, netloc, f"{path}/v1/characters/{character_id}/stream", query, ""))


# --- characters ---


def create_character(options: CharacterOptions) -> Call[CharacterInfo]:
    """Make one."""
    return Call("POST", "/v1/characters", _model(CharacterInfo), dict(options))


def get_character(character_id: str) -> Call[CharacterInfo]:
    """One with its present state."""
    return Call("GET", f"/v1/characters/{character_id}", _model(CharacterInfo))


def list_characters() -> Call[list[CharacterInfo]]:
    """All, oldest first."""
    return Call("GET", "/v1/characters", _items(CharacterInfo))


def delete_character(character_id: str) -> Call[None]:
    """End one."""
    return Call("DELETE", f"/v1/characters/{character_id}", _nothing)


def command(character_id: str, text: str | None, options: CommandOptions) -> Call[CommandTaken]:
    """Tell it what to do; the reply says when the command was taken, and how."""
    body: dict[str, Any] = {"text": text, **options}
    joint = body.pop("joint", TRAJ)
    if "target" in body:
        body["target"] = {"joint": joint, "position_m": _point(body["target"], joint)}
    return Call("POST", f"/v1/characters/{character_id}/commands", _model(CommandTaken), body)


def push(character_id: str, body: str, impulse_ns: Sequence[float]) -> Call[State]:
    """Push a body, newton seconds in the world frame."""
    sent = {"body": body, "impulse_ns": list(impulse_ns)}
    return Call("POST", f"/v1/characters/{character_id}/impulses", _state, sent)


def objects(character_id: str) -> Call[dict[str, ObjectState]]:
    """The objects of the scene by name, now."""
    return Call("GET", f"/v1/characters/{character_id}/objects", _by_name)


def move_object(character_id: str, name: str, options: ObjectOptions) -> Call[ObjectState]:
    """Put an object somewhere, at once."""
    sent = {key: list(cast(Sequence[float], value)) for key, value in options.items()}
    return Call("PUT", f"/v1/characters/{character_id}/objects/{name}", _model(ObjectState), sent)


def act(character_id: str, what: Literal["reset", "pause", "resume"]) -> Call[State]:
    """Stand it up where it is, stop its clock, let it run again."""
    return Call("POST", f"/v1/characters/{character_id}/{what}", _state)


def step(character_id: str, ticks: int) -> Call[State]:
    """Let a lockstep or paused character go on."""
    return Call("POST", f"/v1/characters/{character_id}/steps", _state, {"ticks": ticks}, timeout_s=VIDEO_TIMEOUT_S)


# --- episodes ---


def start_episode(tasks: Sequence[Mapping[str, Any] | BaseModel], options: EpisodeOptions) -> Call[str]:
    """Start one; the reply is its id."""
    listed = [task.model_dump(mode="json") if isinstance(task, BaseModel) else dict(task) for task in tasks]
    return Call("POST", "/v1/episodes", lambda data: str(json.loads(data)["id"]), {**options, "tasks": listed})


def get_episode(episode_id: str) -> Call[EpisodeInfo]:
    """One as it is now."""
    return Call("GET", f"/v1/episodes/{episode_id}", _model(EpisodeInfo))


def list_episodes(status: str | None, limit: int, offset: int) -> Call[list[EpisodeInfo]]:
    """A page of them, newest first."""
    query = {"limit": str(limit), "offset": str(offset), **({} if status is None else {"status": status})}
    return Call("GET", "/v1/episodes", _items(EpisodeInfo), query=query)


def delete_episode(episode_id: str) -> Call[str]:
    """Cancel a running one (`cancelled`), delete one that is over with its recording (`deleted`)."""
    return Call("DELETE", f"/v1/episodes/{episode_id}", lambda data: str(json.loads(data)["status"]))


def skip_task(episode_id: str) -> Call[int]:
    """End the task being performed as failed; the reply is its index."""
    return Call("POST", f"/v1/episodes/{episode_id}/skip", _index)


def insert_task(episode_id: str, task: Mapping[str, Any] | BaseModel, place: int) -> Call[int]:
    """Add a task to a running one; the reply is its index."""
    body = {"task": task.model_dump(mode="json") if isinstance(task, BaseModel) else dict(task), "place": place}
    return Call("POST", f"/v1/episodes/{episode_id}/insert", _index, body)


def _index(data: bytes) -> int:
    return int(json.loads(data)["index"])


def events_path(episode_id: str, since: int) -> str:
    """Of the stream of an episode's events after number `since`."""
    return f"/v1/episodes/{episode_id}/events?since={since}"


# --- motion ---


def motion(owner: Literal["episodes", "characters"], item_id: str, seconds: float | None = None) -> Call[Motion]:
    """Recorded motion as arrays."""
    raw = export(owner, item_id, "npz", seconds=seconds)
    return Call(raw.method, raw.path, Motion.from_npz, query=raw.query, timeout_s=raw.timeout_s)


def export(
    owner: Literal["episodes", "characters"],
    item_id: str,
    kind: Format,
    unit: Literal["m", "cm"] = "m",
    seconds: float | None = None,
) -> Call[bytes]:
    """Recorded motion as a file."""
    query = {} if seconds is None else {"seconds": str(seconds)}
    if kind == "mp4":
        return Call("GET", f"/v1/{owner}/{item_id}/video.mp4", bytes, query=query, timeout_s=VIDEO_TIMEOUT_S)
    if kind == "bvh":
        query["unit"] = unit
    return Call("GET", f"/v1/{owner}/{item_id}/motion.{kind}", bytes, query=query)


def format_of(path: str | Path) -> Format:
    """What a file name asks for; raises InvalidInputError listing the endings there are."""
    suffix = Path(path).suffix.removeprefix(".").lower()
    for kind in FORMATS:
        if suffix == kind:
            return kind
    allowed = ", ".join(f".{kind}" for kind in FORMATS)
    raise InvalidInputError(f"{Path(path).name!r} has no known ending", field="path", allowed=allowed)


# --- services ---


def services() -> Call[ServicesInfo]:
    """What planner and tracker are in use."""
    return Call("GET", "/v1/services", _model(ServicesInfo))


def swap(kind: ServiceKind, plugin: str | None, endpoint: str | None) -> Call[ServiceInfo]:
    """Exchange one."""
    return Call("PUT", f"/v1/services/{kind}", _model(ServiceInfo), {"plugin": plugin, "endpoint": endpoint})


def health() -> Call[ServicesHealth]:
    """How planner and tracker are."""
    return Call("GET", "/v1/services/health", _model(ServicesHealth))


def ready() -> Call[None]:
    """Whether the server and both services answer."""
    return Call("GET", "/readyz", _nothing)


# --- reading replies ---


def _nothing(data: bytes) -> None:
    return None


def _model(kind: type[M]) -> Callable[[bytes], M]:
    def read(data: bytes) -> M:
        try:
            return kind.model_validate_json(data)
        except ValidationError as error:
            raise MalformedMessageError(f"the server's reply is no {kind.__name__}: {error.errors()[0]}") from error

    return read


def _items(kind: type[M]) -> Callable[[bytes], list[M]]:
    return lambda data: [kind.model_validate(item) for item in json.loads(data)["items"]]


def _by_name(data: bytes) -> dict[str, ObjectState]:
    return {item.name: item for item in _items(ObjectState)(data)}


def _state(data: bytes) -> State:
    return State.of(_model(StateFields)(data))


def _point(target: Sequence[float], joint: str) -> list[float]:
    numbers = [float(value) for value in target]
    if len(numbers) == 2 and joint == TRAJ:
        return [*numbers, 0.0]
    if len(numbers) != 3:
        allowed = "(x, y) or (x, y, z) in metres" if joint == TRAJ else "(x, y, z) in metres"
        raise InvalidInputError(f"target {tuple(numbers)} for {joint}", field="target", allowed=allowed)
    return numbers
