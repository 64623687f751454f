"""Messages to and from a tracker (DESIGN 3), version 2. What a tracker tells of a character: `shared.protocol.states`.

Units are SI, frames are world (Z up), quaternions wxyz. Ticks are at 30 Hz.
"""

from __future__ import annotations

import json
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import AfterValidator, Field, FiniteFloat, JsonValue, model_validator

from shared.errors import InvalidInputError
from shared.protocol.arrays import ArraySpec
from shared.protocol.base import Array, Message, Name, is_name
from shared.protocol.planning import Seed, Tick, Vec3
from shared.protocol.rates import PLANNER_FPS, TICK_HZ, Fps, LogRate, frame_of_tick

MAX_SCENE_BYTES = 65_536
SERVO_TARGETS = "servo_targets"
"""The action space that needs no decoding: (A, H) targets of the joint servos in radians, one row a tick."""

Pacing = Literal["realtime", "lockstep"]
Quat = tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]


def _named_or_inline(scene: str | dict[str, JsonValue]) -> str | dict[str, JsonValue]:
    allowed = f"a name of at most 64 letters, digits, . - _, or a scene document of at most {MAX_SCENE_BYTES} bytes"
    if isinstance(scene, str):
        if not is_name(scene):
            raise ValueError(f"{scene[:64]!r} names no scene; allowed: {allowed}")
    elif (size := len(json.dumps(scene))) > MAX_SCENE_BYTES:
        raise ValueError(f"a scene document of {size} bytes; allowed: {allowed}")
    return scene


SceneRef = Annotated[str | dict[str, JsonValue], AfterValidator(_named_or_inline)]
"""A scene by name, or inline: the document as in a scene file (`shared.scenes.schema`), as a JSON object."""


class CreateCharacter(Message):
    """Make a character of the registry in a scene; the reply is a StateFrame. The id is in the envelope."""

    type: ClassVar[str] = "CreateCharacter"
    character: Name = "human"
    scene: SceneRef = "flat"
    tracker: Name | None = None
    pacing: Pacing = "lockstep"
    seed: Seed = 0
    position_w_m: tuple[FiniteFloat, FiniteFloat] = (0.0, 0.0)
    heading_rad: FiniteFloat = 0.0


class CloseCharacter(Message):
    """End a character; the reply is Ok."""

    type: ClassVar[str] = "CloseCharacter"


class SetScene(Message):
    """Put the character into another scene (it is reset); the reply is a StateFrame."""

    type: ClassVar[str] = "SetScene"
    scene: SceneRef


class SetObject(Message):
    """Move an object of the scene, at once; the reply is a StateFrame. What is left out stays as it is.

    Attributes:
        name: of the object, as in StateFrame.objects.
        position_w_m, quat_w: pose of its frame; a fixed object may be moved too.
        linvel_w_mps, angvel_w_radps: of a free object; refused for a fixed one.
    """

    type: ClassVar[str] = "SetObject"
    name: Name
    position_w_m: Vec3 | None = None
    quat_w: Quat | None = None
    linvel_w_mps: Vec3 | None = None
    angvel_w_radps: Vec3 | None = None

    @model_validator(mode="after")
    def _says_something(self) -> SetObject:
        if self.quat_w is not None and sum(part * part for part in self.quat_w) < 1e-6:
            raise InvalidInputError("quat_w is no rotation", field="quat_w", allowed="a quaternion (w, x, y, z)")
        if all(part is None for part in (self.position_w_m, self.quat_w, self.linvel_w_mps, self.angvel_w_radps)):
            raise InvalidInputError(
                f"nothing is said of object {self.name!r}",
                field="position_w_m",
                allowed="at least one of position_w_m, quat_w, linvel_w_mps, angvel_w_radps",
            )
        return self


class SetTracker(Message):
    """Let another tracker plug-in drive the character from the next tick on; the reply is Ok."""

    type: ClassVar[str] = "SetTracker"
    tracker: Name


class SetPacing(Message):
    """Change pacing, or pause a realtime character; the reply is a StateFrame.

    `paused` stops the wall clock only: a lockstep character that is paused still steps on request, shown as paused.
    """

    type: ClassVar[str] = "SetPacing"
    pacing: Pacing
    paused: bool = False


class ResetCharacter(Message):
    """Stand the character up at a place, keeping its clock and log; the reply is a StateFrame."""

    type: ClassVar[str] = "ResetCharacter"
    position_w_m: tuple[FiniteFloat, FiniteFloat] | None = None
    heading_rad: FiniteFloat | None = None


class Track(Message):
    """A plan to perform from `start_tick` on; the reply is TrackReply.

    Attributes:
        positions_w_m: (T, 22, 3) at `fps`, frame i at start_tick / 30 + (i + 1) / fps seconds, for the character's own
            skeleton; rotations_6d: (T, 22, 6), local.
        actions: (A, D) for the ticks start_tick.. in the space named `action_space`, which the character's tracker
            must declare. A plan without actions ends what is left of an old chunk.
        may_be_low: task or text ask for sitting, lying, crawling: being low is then no fall.
    """

    type: ClassVar[str] = "Track"
    start_tick: Tick
    fps: Fps = PLANNER_FPS
    skeleton: str = "human22"
    positions_w_m: Annotated[Array, ArraySpec("<f4", ("T", 22, 3), 4096)]
    rotations_6d: Annotated[Array, ArraySpec("<f4", ("T", 22, 6), 4096)]
    actions: Annotated[Array, ArraySpec("<f4", ("A", "D"), 4096)] = Field(
        default_factory=lambda: np.zeros((0, 0), "<f4")
    )
    action_space: Name | None = None
    may_be_low: bool = False

    @model_validator(mode="after")
    def _fits(self) -> Track:
        frame_of_tick(self.start_tick, self.fps)
        if len(self.actions) and self.action_space is None:
            raise InvalidInputError(
                "actions come without the name of their space", field="action_space", allowed="a name, or no actions"
            )
        return self


class TrackReply(Message):
    """What became of a plan: entered at `entered_tick` (late plans enter at the current one), or dropped."""

    type: ClassVar[str] = "TrackReply"
    accepted: bool
    tick: Tick
    entered_tick: Tick | None = None
    reason: str | None = None


class Step(Message):
    """Lockstep: advance by `ticks`; the reply is the StateFrame after them. Stops early when physics fails."""

    type: ClassVar[str] = "Step"
    ticks: Annotated[int, Field(ge=1, le=3000)]


class Observe(Message):
    """Ask for the present state: a StateFrame. With `since_tick` the reply is a Look: the ticks since then as well, at
    most those of the last 30 s.
    """

    type: ClassVar[str] = "Observe"
    since_tick: int | None = None


class GetTicks(Message):
    """A range of the log, in order: samples at `rate_hz` with start_tick <= time < stop_tick; reply TickRange.

    `start_tick` may be negative: times before the character existed read as its first sample (standing still), so that
    a full prefix is there from the first plan on. `rate_hz` is any that divides 120, the rate of the log.
    """

    type: ClassVar[str] = "GetTicks"
    start_tick: int
    stop_tick: Tick
    rate_hz: LogRate = TICK_HZ
    include_reference: bool = False


class Impulse(Message):
    """Push a body once; the reply is Ok."""

    type: ClassVar[str] = "Impulse"
    body: Name
    impulse_w_ns: Vec3


class TakeSnapshot(Message):
    """Ask for the complete state; the reply is Snapshot."""

    type: ClassVar[str] = "TakeSnapshot"


class Snapshot(Message):
    """Complete state of a character: enough to continue bit for bit. `meta` is JSON, `state` and `buffers` are raw.

    `meta` holds `format`, the protocol version whose tracker took it: Restore refuses another one by name.
    """

    type: ClassVar[str] = "Snapshot"
    tick: Tick
    meta: dict[str, object]
    state: Annotated[Array, ArraySpec("<f8", ("S",), 1_000_000)]
    buffers: Annotated[Array, ArraySpec("|u1", ("Y",), 8_000_000)]


class Restore(Message):
    """Make (or overwrite) the character of the envelope from a snapshot; the reply is a StateFrame."""

    type: ClassVar[str] = "Restore"
    tick: Tick
    meta: dict[str, object]
    state: Annotated[Array, ArraySpec("<f8", ("S",), 1_000_000)]
    buffers: Annotated[Array, ArraySpec("|u1", ("Y",), 8_000_000)]


class Render(Message):
    """Render a range of the log as MP4; the reply is Video."""

    type: ClassVar[str] = "Render"
    start_tick: Tick = 0
    stop_tick: Tick | None = None
    width: Annotated[int, Field(ge=64, le=1920)] = 640
    height: Annotated[int, Field(ge=64, le=1080)] = 480
    camera: Literal["follow", "side", "top"] = "follow"
    captions: list[tuple[Tick, str]] = []


class Video(Message):
    """An MP4 file."""

    type: ClassVar[str] = "Video"
    renderer: Literal["egl", "osmesa", "drawn"]
    note: str | None = None
    mp4: Annotated[Array, ArraySpec("|u1", ("Y",), 64_000_000)]
