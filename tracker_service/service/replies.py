"""Samples of the log as the messages that tell of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from shared.protocol.messages import TICK_HZ, GetTicks, Pacing, StateFrame, TickRange
from tracker_service.simulation.character import SimulatedCharacter
from tracker_service.simulation.recorder import Samples


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
        contact_body=np.zeros(0),
        contact_object=np.zeros(0),
        contact_impulse_ns=np.zeros(0),
        tracking_error_m=float(row["tracking_error_m"]),
        fallen=bool(row["fallen"]),
        plan_end_tick=simulation.reference.plan_end_tick,
        missed_ticks=missed_ticks,
        failure=failure,
    )


def tick_range(message: GetTicks, samples: Samples, objects: Sequence[str]) -> TickRange:
    """The samples (N, ...) that a request asked for."""
    reference = samples["reference_pos_w_m"]
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
        contact_sample=np.zeros(0),
        contact_body=np.zeros(0),
        contact_object=np.zeros(0),
        contact_impulse_ns=np.zeros(0),
        tracking_error_m=samples["tracking_error_m"],
        fallen=samples["fallen"],
        reference_pos_w_m=reference if message.include_reference else reference[:0],
    )
