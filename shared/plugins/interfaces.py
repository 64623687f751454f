"""What a planner and a tracker are. Anything that has these members can be plugged in.

A planner turns what has happened so far (the prefix) and what is wanted into the next seconds of motion. A tracker
turns simulated state and reference motion into targets of the joint servos.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict

from shared.protocol.messages import Plan, PlanRequest

FloatArray = npt.NDArray[np.floating]


class PlannerSpec(BaseModel):
    """What a planner declares in the handshake.

    Attributes:
        name: plug-in name, e.g. `dip`.
        version: of the plug-in.
        weights_sha256: of the weights file, or None for a planner without weights.
        skeleton: id of the skeleton it plans for.
        fps: of prefix and plan.
        prefix_frames: length of the prefix window it wants.
        plan_frames: most frames it plans at once.
        conditions: which of text, target, heading, velocity, keyframes it honours; the others are ignored.
    """

    model_config = ConfigDict(frozen=True)
    name: str
    version: str
    weights_sha256: str | None = None
    skeleton: str
    fps: float
    prefix_frames: int
    plan_frames: int
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


class TrackerSpec(BaseModel):
    """What a tracker declares in the handshake.

    Attributes:
        drives: `pd_targets` (physics with joint servos), `actions` (accepts action chunks too) or `pose` (no physics,
            the reference itself is shown).
    """

    model_config = ConfigDict(frozen=True)
    name: str
    version: str
    weights_sha256: str | None = None
    skeleton: str
    fps: float
    drives: Literal["pd_targets", "actions", "pose"] = "pd_targets"


@dataclass(frozen=True)
class TrackerObservation:
    """State of one character and the reference it should follow, in world frame, J = 22 bodies, H hinges.

    Attributes:
        body_pos_w_m: (J, 3); body_quat_w: (J, 4) wxyz; body_linvel_w_mps: (J, 3); body_angvel_w_radps: (J, 3).
        hinge_pos_rad: (H,); hinge_vel_radps: (H,).
        ref_pos_w_m: (K, J, 3) reference positions at the next K ticks (row 0: the next tick);
            ref_linvel_w_mps: (K, J, 3); ref_quat_w: (K, J, 4).
        ref_hinge_rad: (K, H) reference joint angles at the same ticks.
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
