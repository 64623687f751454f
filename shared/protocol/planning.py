"""Messages to and from a planner (DESIGN 3), version 2.

Units are SI, frames are world (Z up), rotations 6D as in `shared.motion.rotations`. `start_tick` of a plan is the tick
of the last prefix frame, a multiple of 30 / gcd(30, fps) (`shared.protocol.rates`); frame i of the plan is at
start_tick / 30 + (i + 1) / fps seconds, and frame i of a prefix of P at start_tick / 30 + (i + 1 - P) / fps.
"""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, model_validator

from shared.protocol.arrays import ArraySpec
from shared.protocol.base import Array, Message, Name
from shared.protocol.rates import PLANNER_FPS, Fps, frame_of_tick

MAX_TEXT_CHARS = 300
MAX_PREFIX_FRAMES = 60
MAX_PLAN_FRAMES = 200

Vec3 = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Tick = Annotated[int, Field(ge=0, le=2**40)]
Seed = Annotated[int, Field(ge=0, lt=2**63)]
Guidance = Annotated[FiniteFloat, Field(ge=0, le=20)]

CONDITIONS = (
    "text", "target", "heading", "velocity", "facing", "keyframes", "keyframe_rotations", "obstacles",
)  # fmt: skip
"""Everything that a request can ask for, by the names of `PlannerSpec.conditions` and `Plan.ignored_conditions`."""


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


class PlanRequest(Message):
    """Ask for the motion that follows the prefix.

    Attributes:
        planner: plug-in to use; None for the service's default.
        start_tick: tick of the last prefix frame.
        fps: of prefix and plan; the planner's own.
        prefix_positions_w_m: (P, 22, 3); prefix_rotations_6d: (P, 22, 6), local, the root's in the world.
        prefix_velocities_w_mps: (P, 22, 3) the simulation's own velocities; differences of positions only where a
            frame is not simulated (the last `context_frames`).
        context_frames: how many of the last prefix frames are not simulated but the rest of the old plan.
        text: what to do, or None for no text condition.
        targets: joints that should be at places at ticks. heading: which way to face at a tick.
        desired_velocity_w_mps: (x, y) to go with; facing_rad: which way to face all along, whatever the way goes.
        keyframe_ticks: (K,) when; keyframe_mask: (K, 22) which joints' positions hold;
            keyframe_positions_w_m: (K, 22, 3); keyframe_rotation_mask: (K, 22) which joints' rotations hold;
            keyframe_rotations_6d: (K, 22, 6), local as in a plan.
        obstacle_pos_w_m: (O, 3) what to keep away from, as spheres now; obstacle_linvel_w_mps: (O, 3);
            obstacle_radius_m: (O,).
        guidance: classifier-free guidance scale on the text; None for the planner's own default.
        horizon_frames: how many frames to plan.
    """

    type: ClassVar[str] = "PlanRequest"
    planner: Name | None = None
    start_tick: Tick
    fps: Fps = PLANNER_FPS
    prefix_positions_w_m: Annotated[Array, ArraySpec("<f4", ("P", 22, 3), MAX_PREFIX_FRAMES, 1)]
    prefix_rotations_6d: Annotated[Array, ArraySpec("<f4", ("P", 22, 6), MAX_PREFIX_FRAMES, 1)]
    prefix_velocities_w_mps: Annotated[Array, ArraySpec("<f4", ("P", 22, 3), MAX_PREFIX_FRAMES, 1)]
    context_frames: Annotated[int, Field(ge=0, le=MAX_PREFIX_FRAMES)] = 0
    text: Annotated[str, Field(max_length=MAX_TEXT_CHARS)] | None = None
    targets: Annotated[list[JointTarget], Field(max_length=22)] = []
    heading: HeadingTarget | None = None
    desired_velocity_w_mps: tuple[FiniteFloat, FiniteFloat] | None = None
    facing_rad: FiniteFloat | None = None
    keyframe_ticks: Annotated[Array, ArraySpec("<i8", ("K",), 64)] = Field(default_factory=lambda: np.zeros(0, "<i8"))
    keyframe_mask: Annotated[Array, ArraySpec("|u1", ("K", 22), 64)] = Field(
        default_factory=lambda: np.zeros((0, 22), "|u1")
    )
    keyframe_positions_w_m: Annotated[Array, ArraySpec("<f4", ("K", 22, 3), 64)] = Field(
        default_factory=lambda: np.zeros((0, 22, 3), "<f4")
    )
    keyframe_rotation_mask: Annotated[Array, ArraySpec("|u1", ("K", 22), 64)] = Field(
        default_factory=lambda data: np.zeros((len(data.get("keyframe_ticks", ())), 22), "|u1")
    )
    keyframe_rotations_6d: Annotated[Array, ArraySpec("<f4", ("K", 22, 6), 64)] = Field(
        default_factory=lambda data: np.zeros((len(data.get("keyframe_ticks", ())), 22, 6), "<f4")
    )
    obstacle_pos_w_m: Annotated[Array, ArraySpec("<f4", ("O", 3), 64)] = Field(
        default_factory=lambda: np.zeros((0, 3), "<f4")
    )
    obstacle_linvel_w_mps: Annotated[Array, ArraySpec("<f4", ("O", 3), 64)] = Field(
        default_factory=lambda data: np.zeros((len(data.get("obstacle_pos_w_m", ())), 3), "<f4")
    )
    obstacle_radius_m: Annotated[Array, ArraySpec("<f4", ("O",), 64)] = Field(
        default_factory=lambda data: np.zeros(len(data.get("obstacle_pos_w_m", ())), "<f4")
    )
    guidance: Guidance | None = None
    horizon_frames: Annotated[int, Field(ge=1, le=MAX_PLAN_FRAMES)] = 40
    seed: Seed = 0

    @model_validator(mode="after")
    def _starts_on_a_frame(self) -> PlanRequest:
        frame_of_tick(self.start_tick, self.fps)
        return self


class ReadText(Message):
    """Ask which sentence that it knows is nearest to a text; the reply is TextRead."""

    type: ClassVar[str] = "ReadText"
    planner: Name | None = None
    text: Annotated[str, Field(max_length=MAX_TEXT_CHARS)]


class TextRead(Message):
    """How near a text is to what the planner was made from; all None from a planner that keeps no sentences.

    Attributes:
        nearest: the nearest sentence it knows; similarity: at most 1, which is the same.
        far: whether the text is unlike all that it knows.
    """

    type: ClassVar[str] = "TextRead"
    nearest: str | None = None
    similarity: FiniteFloat | None = None
    far: bool | None = None


class Plan(Message):
    """Planned motion from start_tick on.

    Attributes:
        positions_w_m: (T, 22, 3) and rotations_6d: (T, 22, 6), local, at `fps`.
        actions: (A, D) for the ticks start_tick.. in the space named `action_space`, or none.
        ignored_conditions: what was asked and is not honoured: names of CONDITIONS, `target:JOINT` for one joint.
        understood: the text as it was taken, where that is not the text as given (a negated clause is dropped).
        nearest: the sentence it knows that is nearest to a text far from all it knows; None for a text it knows.
        guidance: the scale that was used; None where there is nothing to guide.
        timings_ms: parts of the time it took, by name.
    """

    type: ClassVar[str] = "Plan"
    planner: Name
    weights_id: str | None = None
    skeleton: str = "human22"
    start_tick: Tick
    fps: Fps = PLANNER_FPS
    positions_w_m: Annotated[Array, ArraySpec("<f4", ("T", 22, 3), MAX_PLAN_FRAMES)]
    rotations_6d: Annotated[Array, ArraySpec("<f4", ("T", 22, 6), MAX_PLAN_FRAMES)]
    actions: Annotated[Array, ArraySpec("<f4", ("A", "D"), 4096)] = Field(
        default_factory=lambda: np.zeros((0, 0), "<f4")
    )
    action_space: Name | None = None
    seed: Seed = 0
    ignored_conditions: list[str] = []
    understood: Annotated[str, Field(max_length=MAX_TEXT_CHARS)] | None = None
    nearest: str | None = None
    guidance: float | None = None
    timings_ms: dict[str, float] = {}

    @model_validator(mode="after")
    def _starts_on_a_frame(self) -> Plan:
        frame_of_tick(self.start_tick, self.fps)
        return self
