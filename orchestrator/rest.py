"""Bodies of the HTTP API that the server writes and clients read: one description for both.

World frame: Z up, X forward, Y left, metres, radians, quaternions wxyz. Readers ignore fields they do not know, so a
newer server does not break an older client.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

Point = Annotated[list[float], Field(min_length=3, max_length=3)]
Quaternion = Annotated[list[float], Field(min_length=4, max_length=4)]


class Body(BaseModel):
    """Base: immutable, unknown fields are ignored."""

    model_config = ConfigDict(frozen=True, extra="ignore")


class StateFields(Body):
    """State of a character at a control tick (30 a second).

    Attributes:
        joints: names, in the order of `positions_m` and `rotations_wxyz`.
        positions_m: (22, 3) of the joints; rotations_wxyz: (22, 4) of the bodies, identity in the T-pose facing +X.
        pelvis_m: (3,).
        heading_rad: where the hips face, 0 along +X, anticlockwise.
        contacts: left heel, left toe, right heel, right toe.
        tracking_error_m: mean distance of the joints from the plan.
        plan_end_tick: where the present plan ends; after it the character comes to a stand.
        missed_ticks: ticks that ran more than 33 ms late.
        failure: what went wrong with the physics, if anything.
    """

    tick: int
    time_s: float
    joints: tuple[str, ...]
    positions_m: list[Point]
    rotations_wxyz: list[Quaternion]
    pelvis_m: Point
    heading_rad: float
    contacts: list[bool]
    tracking_error_m: float
    fallen: bool
    plan_end_tick: int
    missed_ticks: int
    tracker: str
    failure: str | None = None


class CharacterFields(Body):
    """A commanded character, without its command and state.

    Attributes:
        status: running, paused, degraded (no planner answers), failed or closed; `reason` says why.
        planner, tracker: plug-ins; a planner of None is the service's own choice.
        plans: made so far.
    """

    id: str
    status: str
    reason: str | None = None
    scene: str
    pacing: str
    planner: str | None = None
    tracker: str | None = None
    seed: int
    plans: int


class NearestSentence(Body):
    """A sentence that the planner was trained on, and how near a text is to it: 1 is the same, below 0.5 is far."""

    text: str
    similarity: float


class CommandReading(Body):
    """How a command was taken.

    Attributes:
        understood: its text without negated clauses, steps in order; a sentence for standing where nothing is left.
        steps: what is done, one thing after the other; the last one holds.
        dropped: clauses that say what not to do.
        nearest: for a text far from every sentence the planner was trained on, the nearest of them; expect little.
        ignored_conditions: what it asks that the planner does not honour.
        unreachable_joints: joints of its target that the planner cannot place.
    """

    understood: str | None = None
    steps: list[str] = []
    dropped: list[str] = []
    nearest: NearestSentence | None = None
    ignored_conditions: list[str] = []
    unreachable_joints: list[str] = []

    @property
    def noteworthy(self) -> bool:
        """Whether it was taken otherwise than it was given, or not all of it is honoured."""
        taken = bool(self.dropped) or len(self.steps) > 1 or self.nearest is not None
        return taken or bool(self.ignored_conditions) or bool(self.unreachable_joints)


class ObjectState(Body):
    """An object of the scene: pose of its frame in the world and how it moves."""

    name: str
    position_m: tuple[float, float, float]
    rotation_wxyz: tuple[float, float, float, float]
    velocity_mps: tuple[float, float, float]
    angular_velocity_radps: tuple[float, float, float]


class TaskResult(Body):
    """How one task of an episode went.

    Attributes:
        success_strict, success_paper, success_code: by the three rules; the first is the headline.
        seconds: from the start of the task to its goal, or its end.
        start_tick, stop_tick: what part of the recording it is.
        reason: why it failed.
        measures: named numbers, SI units in the names.
    """

    index: int
    name: str
    type: str
    label: str
    success_strict: bool
    success_paper: bool
    success_code: bool
    fell: bool
    seconds: float
    start_tick: int
    stop_tick: int
    reason: str | None = None
    measures: dict[str, float] = {}


class EpisodeFields(Body):
    """An episode, running or over, without what was asked for.

    Attributes:
        status: running, finished, failed, cancelled or interrupted.
        success: every task succeeded by the strict rule; None while it runs.
        phase: of the state machine, while it runs.
    """

    id: str
    status: str
    reason: str | None = None
    success: bool | None = None
    phase: str | None = None
    tick: int | None = None
    results: list[TaskResult] = []
    services: dict[str, Any] = {}
    created_s: float
    ended_s: float | None = None


class Event(Body):
    """Something that happened. `seq` counts up from 1 within its character or episode."""

    seq: int
    type: str
    tick: int
    unix_s: float
    data: dict[str, Any] = {}


class ServiceInfo(Body):
    """A planner or tracker in use: where it is, what it says of itself, what else it offers."""

    endpoint: str
    version: str
    plugin: str
    spec: dict[str, Any]
    plugins: list[str]


class ServicesInfo(Body):
    """Both services."""

    planner: ServiceInfo
    tracker: ServiceInfo


class ServiceHealth(Body):
    """One service: `away` when it does not answer, with the reason in `message`."""

    status: Literal["ok", "degraded", "away"]
    plugin: str
    endpoint: str
    latency_ms: float | None = None
    uptime_s: float | None = None
    detail: dict[str, float | int | str] = {}
    message: str | None = None


class ServicesHealth(Body):
    """Both services."""

    planner: ServiceHealth
    tracker: ServiceHealth


class InvalidField(Body):
    """One value that was refused."""

    field: str
    message: str
    allowed: str | None = None


class Problem(Body):
    """Body of every error (RFC 9457), with the extensions `code`, `retryable`, `field`, `allowed` and `errors`."""

    type: str = "about:blank"
    title: str
    status: int
    detail: str
    instance: str | None = None
    code: str
    retryable: bool = False
    field: str | None = None
    allowed: str | None = None
    errors: list[InvalidField] = []
