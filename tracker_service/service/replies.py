"""Samples of the log as the messages that tell of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from shared.errors import InvalidInputError
from shared.protocol.messages import LOG_HZ, TICK_HZ, GetTicks, Pacing, StateFrame, TickRange
from tracker_service.simulation.character import SimulatedCharacter
from tracker_service.simulation.contacts import FLOOR_COLUMN
from tracker_service.simulation.recorder import Samples

MAX_ROWS = 20_000
Impulses = npt.NDArray[Any]
Ints = npt.NDArray[np.int64]


def state_frame(
    character_id: str,
    simulation: SimulatedCharacter,
    row: Samples,
    failure: str | None,
    pacing: Pacing,
    paused: bool,
    missed_ticks: int,
) -> StateFrame:
    """The present state from the newest sample `row`, arrays without the leading axis."""
    poses, speeds = row["object_pose_w"], row["object_vel_w"]
    _, body, touched, impulse = _as_list(row["contact_impulse_ns"][None])
    return StateFrame(
        character_id=character_id,
        character=simulation.human.character.name,
        tick=simulation.tick,
        time_s=simulation.tick / TICK_HZ,
        pacing=pacing,
        paused=paused,
        tracker=simulation.tracker.spec.name,
        scene=simulation.scene.scene.name,
        body_pos_w_m=row["body_pos_w_m"],
        body_quat_w=row["body_quat_w"],
        body_linvel_w_mps=row["body_linvel_w_mps"],
        body_angvel_w_radps=row["body_angvel_w_radps"],
        contacts=row["contacts"],
        reference_pos_w_m=row["reference_pos_w_m"],
        hinge_pos_rad=row["hinge_pos_rad"],
        hinge_vel_radps=row["hinge_vel_radps"],
        servo_target_rad=row["servo_target_rad"],
        objects=list(simulation.scene.object_names),
        object_pos_w_m=poses[:, :3],
        object_quat_w=poses[:, 3:],
        object_linvel_w_mps=speeds[:, :3],
        object_angvel_w_radps=speeds[:, 3:],
        contact_body=body,
        contact_object=touched,
        contact_impulse_ns=impulse,
        tracking_error_m=float(row["tracking_error_m"]),
        fallen=bool(row["fallen"]),
        plan_end_tick=simulation.reference.plan_end_tick,
        missed_ticks=missed_ticks,
        failure=failure,
    )


def check_range(message: GetTicks, now: int, stride: int) -> None:
    """Raise InvalidInputError for a range of the log that has not happened by tick `now`, or is too long.

    Args:
        stride: samples of the log from one row to the next.
    """
    rows = (message.stop_tick - message.start_tick) * (LOG_HZ // TICK_HZ) // stride
    if message.stop_tick > now + 1:
        raise InvalidInputError(
            f"tick {message.stop_tick - 1} has not happened yet", field="stop_tick", allowed=f"<= {now + 1}"
        )
    if message.start_tick > message.stop_tick:
        raise InvalidInputError(
            f"start_tick {message.start_tick} is after stop_tick", field="start_tick",
            allowed=f"<= {message.stop_tick}",
        )  # fmt: skip
    if rows > MAX_ROWS:
        raise InvalidInputError(f"{rows} samples in one range", field="stop_tick", allowed=f"{MAX_ROWS} samples")


def tick_range(message: GetTicks, samples: Samples, impulses: Impulses, objects: Sequence[str]) -> TickRange:
    """The samples (N, ...) that a request asked for, and the impulses (N, J, 1 + O) since the sample before each."""
    reference = samples["reference_pos_w_m"]
    sample, body, touched, impulse = _as_list(impulses)
    return TickRange(
        start_tick=message.start_tick,
        rate_hz=message.rate_hz,
        objects=list(objects),
        body_pos_w_m=samples["body_pos_w_m"],
        body_quat_w=samples["body_quat_w"],
        body_linvel_w_mps=samples["body_linvel_w_mps"],
        body_angvel_w_radps=samples["body_angvel_w_radps"],
        contacts=samples["contacts"],
        hinge_pos_rad=samples["hinge_pos_rad"],
        hinge_vel_radps=samples["hinge_vel_radps"],
        servo_target_rad=samples["servo_target_rad"],
        object_pose_w=samples["object_pose_w"],
        object_vel_w=samples["object_vel_w"],
        contact_sample=sample,
        contact_body=body,
        contact_object=touched,
        contact_impulse_ns=impulse,
        tracking_error_m=samples["tracking_error_m"],
        fallen=samples["fallen"],
        reference_pos_w_m=reference if message.include_reference else reference[:0],
    )


def _as_list(impulses: Impulses) -> tuple[Ints, Ints, Ints, Impulses]:
    """Sample, body, object (FLOOR for the floor) and impulse of every contact in impulses (N, J, 1 + O)."""
    sample, body, column = np.nonzero(impulses > 0)
    return sample, body, column - 1 - FLOOR_COLUMN, impulses[sample, body, column]
