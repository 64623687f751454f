"""What a tracker tells of a character: its state now, ranges of its log, and both in one reply.

Units are SI, frames are world (Z up), quaternions wxyz. N samples, J = 22 bodies in the skeleton's order, H hinges in
the order of the character's servos, O scene objects in the order of `objects`, C contacts.

A contact is a body of the character touching something: `contact_body` is its index in the skeleton,
`contact_object` the index of the object it touches, or -1 for the floor, `contact_impulse_ns` the normal impulse (N s)
that passed between the two, summed over their contact points and over the physics steps since the sample before (in a
StateFrame: since the tick before).
"""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from pydantic import BaseModel, ConfigDict

from shared.protocol.arrays import ArraySpec
from shared.protocol.base import Array, Message, Name
from shared.protocol.planning import Tick
from shared.protocol.tracking import Pacing

FLOOR = -1
"""`contact_object` of a contact with the floor."""
MAX_OBJECTS = 64
MAX_HINGES = 256
MAX_CONTACTS = 1024


class StateFrame(Message):
    """State of a character at a tick.

    Attributes:
        time_s: tick / 30.
        scene: its name; `inline` where the document has none.
        body_pos_w_m (J, 3), body_quat_w (J, 4), body_linvel_w_mps (J, 3), body_angvel_w_radps (J, 3).
        contacts: (4,) 1 where left heel, left toe, right heel, right toe touch something.
        reference_pos_w_m: (J, 3) the reference at this tick.
        hinge_pos_rad, hinge_vel_radps, servo_target_rad: (H,) angles, rates and what the servos were told last.
        objects: names of the scene objects.
        object_pos_w_m (O, 3), object_quat_w (O, 4), object_linvel_w_mps (O, 3), object_angvel_w_radps (O, 3).
        contact_body, contact_object, contact_impulse_ns: (C,) see above.
        tracking_error_m: mean joint distance to the reference.
        plan_end_tick: last tick covered by a plan; after it the character is extended into a stand.
    """

    type: ClassVar[str] = "StateFrame"
    character_id: str
    character: Name = "human"
    tick: Tick
    time_s: float
    pacing: Pacing
    paused: bool = False
    tracker: Name
    scene: Name
    body_pos_w_m: Annotated[Array, ArraySpec("<f4", (22, 3))]
    body_quat_w: Annotated[Array, ArraySpec("<f4", (22, 4))]
    body_linvel_w_mps: Annotated[Array, ArraySpec("<f4", (22, 3))]
    body_angvel_w_radps: Annotated[Array, ArraySpec("<f4", (22, 3))]
    contacts: Annotated[Array, ArraySpec("|u1", (4,))]
    reference_pos_w_m: Annotated[Array, ArraySpec("<f4", (22, 3))]
    hinge_pos_rad: Annotated[Array, ArraySpec("<f4", ("H",), MAX_HINGES)]
    hinge_vel_radps: Annotated[Array, ArraySpec("<f4", ("H",), MAX_HINGES)]
    servo_target_rad: Annotated[Array, ArraySpec("<f4", ("H",), MAX_HINGES)]
    objects: list[str] = []
    object_pos_w_m: Annotated[Array, ArraySpec("<f4", ("O", 3), MAX_OBJECTS)]
    object_quat_w: Annotated[Array, ArraySpec("<f4", ("O", 4), MAX_OBJECTS)]
    object_linvel_w_mps: Annotated[Array, ArraySpec("<f4", ("O", 3), MAX_OBJECTS)]
    object_angvel_w_radps: Annotated[Array, ArraySpec("<f4", ("O", 3), MAX_OBJECTS)]
    contact_body: Annotated[Array, ArraySpec("<i8", ("C",), MAX_CONTACTS)]
    contact_object: Annotated[Array, ArraySpec("<i8", ("C",), MAX_CONTACTS)]
    contact_impulse_ns: Annotated[Array, ArraySpec("<f4", ("C",), MAX_CONTACTS)]
    tracking_error_m: float
    fallen: bool
    plan_end_tick: int = -1
    missed_ticks: int = 0
    failure: str | None = None


class TickRange(Message):
    """N samples of the log at rate_hz; sample i is at start_tick / 30 + i / rate_hz seconds.

    Attributes:
        body_*: (N, J, ...), contacts: (N, 4), hinge_*, servo_target_rad: (N, H), as in a StateFrame.
        object_pose_w: (N, O, 7) position and quaternion; object_vel_w: (N, O, 6) linear and angular velocity.
        contact_sample: (C,) the sample that each contact belongs to, in rising order; contact_body, contact_object,
            contact_impulse_ns: (C,) see above.
        reference_pos_w_m: (R, J, 3) the reference at the same times; R = N if asked for, else 0.
    """

    type: ClassVar[str] = "TickRange"
    start_tick: int
    rate_hz: int
    objects: list[str] = []
    body_pos_w_m: Annotated[Array, ArraySpec("<f4", ("N", 22, 3))]
    body_quat_w: Annotated[Array, ArraySpec("<f4", ("N", 22, 4))]
    body_linvel_w_mps: Annotated[Array, ArraySpec("<f4", ("N", 22, 3))]
    body_angvel_w_radps: Annotated[Array, ArraySpec("<f4", ("N", 22, 3))]
    contacts: Annotated[Array, ArraySpec("|u1", ("N", 4))]
    hinge_pos_rad: Annotated[Array, ArraySpec("<f4", ("N", "H"))]
    hinge_vel_radps: Annotated[Array, ArraySpec("<f4", ("N", "H"))]
    servo_target_rad: Annotated[Array, ArraySpec("<f4", ("N", "H"))]
    object_pose_w: Annotated[Array, ArraySpec("<f4", ("N", "O", 7))]
    object_vel_w: Annotated[Array, ArraySpec("<f4", ("N", "O", 6))]
    contact_sample: Annotated[Array, ArraySpec("<i8", ("C",), 1_000_000)]
    contact_body: Annotated[Array, ArraySpec("<i8", ("C",), 1_000_000)]
    contact_object: Annotated[Array, ArraySpec("<i8", ("C",), 1_000_000)]
    contact_impulse_ns: Annotated[Array, ArraySpec("<f4", ("C",), 1_000_000)]
    tracking_error_m: Annotated[Array, ArraySpec("<f4", ("N",))]
    fallen: Annotated[Array, ArraySpec("|u1", ("N",))]
    reference_pos_w_m: Annotated[Array, ArraySpec("<f4", ("R", 22, 3))]


class StateFacts(BaseModel):
    """What a StateFrame says beside its arrays."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    character_id: str
    character: Name
    tick: Tick
    time_s: float
    pacing: Pacing
    paused: bool
    tracker: Name
    scene: Name
    tracking_error_m: float
    fallen: bool
    plan_end_tick: int
    missed_ticks: int
    failure: str | None


class Look(TickRange):
    """Reply to Observe with `since_tick`: the log at 30 Hz, with references, its last row the present tick, and the
    rest of the present state. Taken in one go, so that state and log agree while a clock runs.
    """

    type: ClassVar[str] = "Look"
    facts: StateFacts

    @classmethod
    def of(cls, state: StateFrame, ticks: TickRange) -> Look:
        """From a state and the log up to it, which were checked when they were made."""
        facts = StateFacts.model_construct(**{name: getattr(state, name) for name in StateFacts.model_fields})
        return cls.model_construct(facts=facts, **{name: getattr(ticks, name) for name in TickRange.model_fields})

    def state(self) -> StateFrame:
        """The present state, of arrays that were checked when this came."""
        latest = self.contact_sample == len(self.body_pos_w_m) - 1
        rows = {
            name: getattr(self, name)[-1]
            for name in (
                "body_pos_w_m", "body_quat_w", "body_linvel_w_mps", "body_angvel_w_radps", "contacts",
                "reference_pos_w_m", "hinge_pos_rad", "hinge_vel_radps", "servo_target_rad",
            )
        }  # fmt: skip
        return StateFrame.model_construct(
            **{name: getattr(self.facts, name) for name in StateFacts.model_fields},
            **rows,
            objects=self.objects,
            object_pos_w_m=self.object_pose_w[-1, :, :3],
            object_quat_w=self.object_pose_w[-1, :, 3:],
            object_linvel_w_mps=self.object_vel_w[-1, :, :3],
            object_angvel_w_radps=self.object_vel_w[-1, :, 3:],
            contact_body=self.contact_body[latest],
            contact_object=self.contact_object[latest],
            contact_impulse_ns=np.asarray(self.contact_impulse_ns[latest]),
        )
