"""The messages of planner and tracker (DESIGN 3), version 1, and the table of all messages.

Units are SI, frames are world (Z up), quaternions wxyz. `start_tick` of a plan is the tick (30 Hz) of the last prefix
frame, divisible by 3; frame i of the plan is at start_tick / 30 + (i + 1) / fps seconds.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Final, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from shared.protocol.arrays import ArraySpec
from shared.protocol.base import Array, Message, Name
from shared.protocol.control import ErrorReply, Health, HealthReport, Hello, Ok, Welcome

TICK_HZ: Final = 30
PLANNER_FPS: Final = 20
PHYSICS_HZ: Final = 120
MAX_TEXT_CHARS = 300

Vec3 = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Tick = Annotated[int, Field(ge=0, le=2**40)]
Seed = Annotated[int, Field(ge=0, lt=2**63)]
Pacing = Literal["realtime", "lockstep"]

Positions = Annotated[Array, ArraySpec("<f4", ("T", 22, 3), 4096)]
Rotations = Annotated[Array, ArraySpec("<f4", ("T", 22, 6), 4096)]


class JointTarget(BaseModel):
    """A joint should be at a place at a tick. `joint` is a skeleton joint or `traj` (the root on the floor)."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    joint: Name
    position_w_m: Vec3
    arrival_tick: Tick


class HeadingTarget(BaseModel):
    """The body should face `heading_rad` (about Z, 0 along +X) at a tick."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    heading_rad: FiniteFloat
    arrival_tick: Tick


# --- planner --------------------------------------------------------------------------------------------------------


class PlanRequest(Message):
    """Ask for the motion that follows the prefix.

    Attributes:
        planner: plug-in to use; None for the service's default.
        start_tick: tick of the last prefix frame, divisible by 3.
        prefix_positions_w_m, prefix_velocities_w_mps: (P, 22, 3); prefix_rotations_6d: (P, 22, 6), local.
        text: what to do, or None for no text condition.
        targets, heading, desired_velocity_w_mps: what else to do.
        keyframe_ticks: (K,); keyframe_mask: (K, 22) which joints hold; keyframe_positions_w_m: (K, 22, 3).
        guidance: classifier-free guidance scale on the text; None for the planner's own default.
        horizon_frames: how many frames to plan.
        context_frames: how many of the last prefix frames are not simulated but the rest of the old plan.
    """

    type: ClassVar[str] = "PlanRequest"
    planner: Name | None = None
    start_tick: Annotated[int, Field(ge=0, multiple_of=3)]
    fps: Literal[20] = PLANNER_FPS
    prefix_positions_w_m: Annotated[Array, ArraySpec("<f4", ("P", 22, 3), 256)]
    prefix_rotations_6d: Annotated[Array, ArraySpec("<f4", ("P", 22, 6), 256)]
    prefix_velocities_w_mps: Annotated[Array, ArraySpec("<f4", ("P", 22, 3), 256)]
    context_frames: Annotated[int, Field(ge=0, le=255)] = 0
    text: Annotated[str, Field(max_length=MAX_TEXT_CHARS)] | None = None
    targets: Annotated[list[JointTarget], Field(max_length=22)] = []
    heading: HeadingTarget | None = None
    desired_velocity_w_mps: tuple[FiniteFloat, FiniteFloat] | None = None
    keyframe_ticks: Annotated[Array, ArraySpec("<i8", ("K",), 64)] = Field(default_factory=lambda: np.zeros(0, "<i8"))
    keyframe_mask: Annotated[Array, ArraySpec("|u1", ("K", 22), 64)] = Field(
        default_factory=lambda: np.zeros((0, 22), "|u1")
    )
    keyframe_positions_w_m: Annotated[Array, ArraySpec("<f4", ("K", 22, 3), 64)] = Field(
        default_factory=lambda: np.zeros((0, 22, 3), "<f4")
    )
    guidance: Annotated[FiniteFloat, Field(ge=0, le=20)] | None = None
    horizon_frames: Annotated[int, Field(ge=1, le=200)] = 40
    seed: Seed = 0


class Plan(Message):
    """Planned motion: (T, 22, 3) positions and (T, 22, 6) local rotations at `fps`, from start_tick on."""

    type: ClassVar[str] = "Plan"
    planner: Name
    weights_id: str | None = None
    skeleton: str = "human22"
    start_tick: Annotated[int, Field(ge=0, multiple_of=3)]
    fps: Literal[20] = PLANNER_FPS
    positions_w_m: Positions
    rotations_6d: Rotations
    seed: Seed = 0
    ignored_conditions: list[str] = []
    timings_ms: dict[str, float] = {}


# --- tracker --------------------------------------------------------------------------------------------------------


class CreateCharacter(Message):
    """Make a character; the reply is a StateFrame. The id is in the envelope."""

    type: ClassVar[str] = "CreateCharacter"
    character: Name = "human"
    scene: Name = "flat"
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
    scene: Name


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
    """A plan (or an action chunk) to perform from `start_tick` on; the reply is TrackReply.

    Attributes:
        actions: (A, H) servo targets in radians for the ticks start_tick.., only for trackers that accept them.
    """

    type: ClassVar[str] = "Track"
    start_tick: Annotated[int, Field(ge=0, multiple_of=3)]
    fps: Literal[20] = PLANNER_FPS
    skeleton: str = "human22"
    positions_w_m: Positions
    rotations_6d: Rotations
    actions: Annotated[Array, ArraySpec("<f4", ("A", "H"), 4096)] = Field(
        default_factory=lambda: np.zeros((0, 0), "<f4")
    )


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
    """Ask for the present StateFrame."""

    type: ClassVar[str] = "Observe"


class StateFrame(Message):
    """State of a character at a tick. B = 22 bodies, O = scene objects, C = 4 contacts (heel L/R, toe L/R).

    Attributes:
        objects: names of the scene objects, in the order of object_pos_w_m (O, 3) and object_quat_w (O, 4).
        contacts: (4,) 1 where left heel, left toe, right heel, right toe touch something.
        tracking_error_m: mean joint distance to the reference.
        reference_pos_w_m: (22, 3) the reference at this tick.
        plan_end_tick: last tick covered by a plan; after it the character is extended into a stand.
    """

    type: ClassVar[str] = "StateFrame"
    character_id: str
    tick: Tick
    time_s: float
    pacing: Pacing
    paused: bool = False
    tracker: Name
    scene: Name
    body_pos_w_m: Annotated[Array, ArraySpec("<f4", (22, 3))]
    body_quat_w: Annotated[Array, ArraySpec("<f4", (22, 4))]
    body_linvel_w_mps: Annotated[Array, ArraySpec("<f4", (22, 3))]
    contacts: Annotated[Array, ArraySpec("|u1", (4,))]
    reference_pos_w_m: Annotated[Array, ArraySpec("<f4", (22, 3))]
    objects: list[str] = []
    object_pos_w_m: Annotated[Array, ArraySpec("<f4", ("O", 3), 64)] = Field(
        default_factory=lambda: np.zeros((0, 3), "<f4")
    )
    object_quat_w: Annotated[Array, ArraySpec("<f4", ("O", 4), 64)] = Field(
        default_factory=lambda: np.zeros((0, 4), "<f4")
    )
    tracking_error_m: float
    fallen: bool
    plan_end_tick: int = -1
    missed_ticks: int = 0
    failure: str | None = None


class GetTicks(Message):
    """A range of the log, in order: samples at `rate_hz` with start_tick <= time < stop_tick; reply TickRange.

    `start_tick` may be negative: times before the character existed read as its first sample (standing still), so that
    a full prefix is there from the first plan on.
    """

    type: ClassVar[str] = "GetTicks"
    start_tick: int
    stop_tick: Tick
    rate_hz: Literal[20, 30, 60] = TICK_HZ
    include_reference: bool = False


class TickRange(Message):
    """N samples of the log at rate_hz; sample i is at start_tick / 30 + i / rate_hz seconds.

    Attributes:
        reference_pos_w_m: (R, 22, 3) the reference at the same times; R = N if asked for, else 0.
        object_pose_w: (N, O, 7) position and quaternion.
    """

    type: ClassVar[str] = "TickRange"
    start_tick: int
    rate_hz: int
    objects: list[str] = []
    body_pos_w_m: Annotated[Array, ArraySpec("<f4", ("N", 22, 3))]
    body_quat_w: Annotated[Array, ArraySpec("<f4", ("N", 22, 4))]
    body_linvel_w_mps: Annotated[Array, ArraySpec("<f4", ("N", 22, 3))]
    contacts: Annotated[Array, ArraySpec("|u1", ("N", 4))]
    object_pose_w: Annotated[Array, ArraySpec("<f4", ("N", "O", 7))]
    tracking_error_m: Annotated[Array, ArraySpec("<f4", ("N",))]
    fallen: Annotated[Array, ArraySpec("|u1", ("N",))]
    reference_pos_w_m: Annotated[Array, ArraySpec("<f4", ("R", 22, 3))]


class Impulse(Message):
    """Push a body once; the reply is Ok."""

    type: ClassVar[str] = "Impulse"
    body: Name
    impulse_w_ns: Vec3


class TakeSnapshot(Message):
    """Ask for the complete state; the reply is Snapshot."""

    type: ClassVar[str] = "TakeSnapshot"


class Snapshot(Message):
    """Complete state of a character: enough to continue bit for bit. `meta` is JSON, `state` and `buffers` are raw."""

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


MESSAGES: dict[str, type[Message]] = {
    cls.type: cls
    for cls in (
        Hello, Welcome, Health, HealthReport, ErrorReply, Ok, PlanRequest, Plan, CreateCharacter, CloseCharacter,
        SetScene, SetTracker, SetPacing, ResetCharacter, Track, TrackReply, Step, Observe, StateFrame, GetTicks,
        TickRange, Impulse, TakeSnapshot, Snapshot, Restore, Render, Video,
    )
}  # fmt: skip
