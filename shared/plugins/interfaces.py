"""What a planner and a tracker are. Anything that has these members can be plugged in.

A planner turns what has happened so far (the prefix) and what is wanted into the next seconds of motion. A tracker
turns simulated state and reference motion into targets of the joint servos.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Final, Literal, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field

from shared.protocol.messages import MAX_PLAN_FRAMES, MAX_PREFIX_FRAMES, Plan, PlanRequest, TextRead
from shared.protocol.rates import Fps

FloatArray = npt.NDArray[np.floating]


class PlannerSpec(BaseModel):
    """What a planner declares in the handshake.

    Attributes:
        name: plug-in name, e.g. `dip`.
        version: of the plug-in.
        weights_sha256: of the weights file, or None for a planner without weights.
        skeleton: id of the skeleton it plans for.
        fps: of prefix and plan: a divisor of 120 from 5 to 60 (`shared.protocol.rates`).
        prefix_frames: length of the prefix window it wants, 1 to 60.
        plan_frames: most frames it plans at once, 4 to 200.
        replan_frames: after how many of its frames it wants to plan again; None leaves that to the loop's settings.
        target_joints: joints that a target can be for; None for any.
        conditions: which of `CONDITIONS` it honours; a request's others are ignored, and reported as ignored.
    """

    model_config = ConfigDict(frozen=True)
    name: str
    version: str
    weights_sha256: str | None = None
    skeleton: str
    fps: Fps
    prefix_frames: Annotated[int, Field(ge=1, le=MAX_PREFIX_FRAMES)]
    plan_frames: Annotated[int, Field(ge=4, le=MAX_PLAN_FRAMES)]
    replan_frames: Annotated[int, Field(ge=1, le=MAX_PLAN_FRAMES)] | None = None
    target_joints: tuple[str, ...] | None = None
    conditions: tuple[str, ...] = ()


@runtime_checkable
class Planner(Protocol):
    """Plans motion for a batch of characters."""

    @property
    def spec(self) -> PlannerSpec:
        """What this planner is and takes."""
        ...

    def plan(self, requests: list[PlanRequest]) -> list[Plan]:
        """One plan for each request, in order.

        The same request with the same seed gives the same plan whatever else is in the batch (to float precision;
        bit for bit when the batch has the same composition).
        """
        ...


@runtime_checkable
class TextReader(Protocol):
    """What a planner may have beside `Planner`: it knows which texts it was made from."""

    def read_text(self, text: str) -> TextRead:
        """The sentence it knows that is nearest to a text. Called from any thread, also while it plans."""
        ...


class TrackerSpec(BaseModel):
    """What a tracker declares in the handshake.

    Attributes:
        drives: `pd_targets` (physics with joint servos) or `pose` (no physics, the reference itself is shown).
        characters: the characters of the registry that it drives; None for any.
        action_spaces: spaces of the action chunks it takes: `servo_targets` (radians, no decoding), and at most one
            other, whose rows the tracker's `decode` turns into servo targets with the present state at every tick.
        gets_up: it can follow a way up from lying. Characters of others are put on their feet after a fall.
    """

    model_config = ConfigDict(frozen=True)
    name: str
    version: str
    weights_sha256: str | None = None
    skeleton: str
    fps: float
    gets_up: bool = False
    drives: Literal["pd_targets", "pose"] = "pd_targets"
    characters: tuple[str, ...] | None = ("human",)
    action_spaces: tuple[str, ...] = ()


NEAR_OBJECTS: Final = 4
"""How many primitives of the scene a tracker is shown: those whose surface is nearest to the pelvis, nearest first."""
NEAR_OBJECT_M: Final = 3.0
"""Farther than this from the pelvis nothing is shown."""
GROUND_GRID_M: Final = (-0.4, 0.0, 0.4)
"""Offsets of the ground grid along and across the heading, from the point under the pelvis."""


def _none(*shape: int) -> FloatArray:
    return np.zeros(shape)


@dataclass(frozen=True)
class TrackerObservation:
    """State of one character and the reference it should follow, in world frame, J = 22 bodies, H hinges.

    Attributes:
        body_pos_w_m: (J, 3); body_quat_w: (J, 4) wxyz; body_linvel_w_mps: (J, 3); body_angvel_w_radps: (J, 3).
        hinge_pos_rad: (H,); hinge_vel_radps: (H,).
        ref_pos_w_m: (K, J, 3) reference positions at the next K ticks (row 0: the next tick);
            ref_linvel_w_mps: (K, J, 3); ref_quat_w: (K, J, 4).
        ref_hinge_rad: (K, H) reference joint angles at the same ticks.
        near_mask: (NEAR_OBJECTS,) 1 where a row of the following describes a primitive (a box, sphere, capsule or
            cylinder of a scene object), 0 where there is none (the row is zeros): near_pos_w_m: (NEAR_OBJECTS, 3) its
            centre; near_quat_w: (NEAR_OBJECTS, 4); near_half_size_m: (NEAR_OBJECTS, 3) half the edges of its box along
            its own axes; near_linvel_w_mps: (NEAR_OBJECTS, 3) velocity of its centre.
        ground_height_w_m: (9,) height of what one could step on at a 3 x 3 grid around the point under the pelvis
            (GROUND_GRID_M; turned with the pelvis' heading; row 3 i + j is i-th along, j-th to the left).
        foot_height_w_m: (2,) the same under the left and the right foot.
        seat_height_w_m: (1,) the same under the pelvis.

    Heights are those of the topmost surface below the pelvis of fixed objects and of what has an area marked to sit or
    stand on; 0 on the floor.
    """

    body_pos_w_m: FloatArray
    body_quat_w: FloatArray
    body_linvel_w_mps: FloatArray
    body_angvel_w_radps: FloatArray
    hinge_pos_rad: FloatArray
    hinge_vel_radps: FloatArray
    ref_pos_w_m: FloatArray
    ref_linvel_w_mps: FloatArray
    ref_quat_w: FloatArray
    ref_hinge_rad: FloatArray
    near_mask: FloatArray = field(default_factory=lambda: _none(NEAR_OBJECTS))
    near_pos_w_m: FloatArray = field(default_factory=lambda: _none(NEAR_OBJECTS, 3))
    near_quat_w: FloatArray = field(default_factory=lambda: _none(NEAR_OBJECTS, 4))
    near_half_size_m: FloatArray = field(default_factory=lambda: _none(NEAR_OBJECTS, 3))
    near_linvel_w_mps: FloatArray = field(default_factory=lambda: _none(NEAR_OBJECTS, 3))
    ground_height_w_m: FloatArray = field(default_factory=lambda: _none(len(GROUND_GRID_M) ** 2))
    foot_height_w_m: FloatArray = field(default_factory=lambda: _none(2))
    seat_height_w_m: FloatArray = field(default_factory=lambda: _none(1))


@runtime_checkable
class Tracker(Protocol):
    """Drives a batch of characters along their references."""

    @property
    def spec(self) -> TrackerSpec:
        """What this tracker is."""
        ...

    def reset(self, character_ids: Sequence[str]) -> None:
        """Forget any state kept for these characters (called at creation, reset and restore)."""
        ...

    def act(self, character_ids: Sequence[str], observations: Sequence[TrackerObservation]) -> FloatArray:
        """(B, H) servo targets in radians for the next tick, in the order given."""
        ...


@runtime_checkable
class LatentTracker(Tracker, Protocol):
    """A tracker that takes action chunks in a latent space of its own (`TrackerSpec.action_spaces`)."""

    def decode(self, latents: FloatArray, observations: Sequence[TrackerObservation]) -> FloatArray:
        """(B, H) servo targets in radians for the next tick, from this tick's latents (B, D) and the present state.

        Raises:
            InvalidInputError: D is not the width of its space.
        """
        ...
