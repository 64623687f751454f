"""One sample of every message, the same bytes each time; `python -m tests.protocol.samples` writes the golden files."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from shared.protocol import control as c
from shared.protocol import messages as m
from shared.protocol.base import Message
from shared.protocol.codec import encode

GOLDEN = Path(__file__).parent / "golden"


def _ramp(*shape: int, dtype: str = "<f4") -> np.ndarray:
    values = np.arange(int(np.prod(shape))).reshape(shape)
    return (values % 2).astype(dtype) if dtype == "|u1" else (values * 0.125 - 1.0).astype(dtype)


def _frame() -> m.StateFrame:
    return m.StateFrame(
        character_id="walker", tick=90, time_s=3.0, pacing="lockstep", tracker="pd", scene="flat",
        body_pos_w_m=_ramp(22, 3), body_quat_w=_ramp(22, 4), body_linvel_w_mps=_ramp(22, 3),
        body_angvel_w_radps=_ramp(22, 3), contacts=_ramp(4, dtype="|u1"), reference_pos_w_m=_ramp(22, 3),
        hinge_pos_rad=_ramp(5), hinge_vel_radps=_ramp(5), servo_target_rad=_ramp(5), objects=["bag"],
        object_pos_w_m=_ramp(1, 3), object_quat_w=_ramp(1, 4), object_linvel_w_mps=_ramp(1, 3),
        object_angvel_w_radps=_ramp(1, 3), contact_body=np.array([7, 8]), contact_object=np.array([-1, 0]),
        contact_impulse_ns=_ramp(2), tracking_error_m=0.03125, fallen=False, plan_end_tick=120,
    )  # fmt: skip


def _range(samples: int = 2, references: int = 0, impulses: int = 1) -> m.TickRange:
    n = samples
    return m.TickRange(
        start_tick=0, rate_hz=30, objects=["bag"], body_pos_w_m=_ramp(n, 22, 3), body_quat_w=_ramp(n, 22, 4),
        body_linvel_w_mps=_ramp(n, 22, 3), body_angvel_w_radps=_ramp(n, 22, 3), contacts=_ramp(n, 4, dtype="|u1"),
        hinge_pos_rad=_ramp(n, 5), hinge_vel_radps=_ramp(n, 5), servo_target_rad=_ramp(n, 5),
        object_pose_w=_ramp(n, 1, 7), object_vel_w=_ramp(n, 1, 6), contact_sample=np.arange(impulses),
        contact_body=np.arange(impulses), contact_object=np.arange(impulses) - 1,
        contact_impulse_ns=_ramp(impulses), tracking_error_m=_ramp(n), fallen=_ramp(n, dtype="|u1"),
        reference_pos_w_m=_ramp(references, 22, 3),
    )  # fmt: skip


SAMPLES: tuple[Message, ...] = (
    c.Hello(client="test", plugin="stand"),
    c.Welcome(service="planner", version="0.1.0", instance_id="0" * 32, default_plugin="stand",
              plugins=[{"name": "stand", "skeleton": "human22"}]),
    c.Health(),
    c.HealthReport(status="ok", uptime_s=1.5, detail={"pending": 0, "default": "stand"}),
    c.ErrorReply(code="invalid_input", message="unknown joint 'tail'", field="targets.0.joint", allowed="pelvis"),
    c.Ok(),
    m.PlanRequest(
        planner="stand", start_tick=30, prefix_positions_w_m=_ramp(2, 22, 3), prefix_rotations_6d=_ramp(2, 22, 6),
        prefix_velocities_w_mps=_ramp(2, 22, 3), context_frames=1, text="a person walks – slowly",
        targets=[m.JointTarget(joint="traj", position_w_m=(1.0, -2.0, 0.0), arrival_tick=75)],
        heading=m.HeadingTarget(heading_rad=0.5, arrival_tick=75), desired_velocity_w_mps=(1.0, 0.0),
        keyframe_ticks=np.array([60]), keyframe_mask=_ramp(1, 22, dtype="|u1"),
        keyframe_positions_w_m=_ramp(1, 22, 3), keyframe_rotation_mask=_ramp(1, 22, dtype="|u1"),
        keyframe_rotations_6d=_ramp(1, 22, 6), facing_rad=0.75, obstacle_pos_w_m=_ramp(2, 3),
        obstacle_linvel_w_mps=_ramp(2, 3), obstacle_radius_m=np.array([0.5, 0.25]), guidance=2.5,
        horizon_frames=40, seed=2**53 + 1,
    ),
    m.Plan(planner="stand", weights_id="abc", start_tick=30, positions_w_m=_ramp(3, 22, 3),
           rotations_6d=_ramp(3, 22, 6), fps=40, actions=_ramp(2, 4), action_space="latent",
           understood="walk", nearest="a person walks", guidance=2.5, seed=7,
           ignored_conditions=["keyframes"], timings_ms={"plan": 1.5}),
    m.ReadText(planner="dip", text="amble"),
    m.TextRead(nearest="walk", similarity=0.5, far=False),
    m.CreateCharacter(tracker="pd", pacing="realtime", seed=3, position_w_m=(1.0, 2.0), heading_rad=0.25),
    m.CloseCharacter(),
    m.SetScene(scene={"name": "mine", "bodies": [{"name": "crate", "shape": "box"}]}),
    m.SetObject(name="bag", position_w_m=(1.0, 0.0, 0.5), quat_w=(1.0, 0.0, 0.0, 0.0), linvel_w_mps=(0.0, 1.0, 0.0)),
    m.SetTracker(tracker="ppo"),
    m.SetPacing(pacing="realtime", paused=True),
    m.ResetCharacter(position_w_m=(0.0, 1.0), heading_rad=-1.0),
    m.Track(start_tick=33, positions_w_m=_ramp(2, 22, 3), rotations_6d=_ramp(2, 22, 6), actions=_ramp(1, 4),
            action_space=m.SERVO_TARGETS, may_be_low=True),
    m.TrackReply(accepted=False, tick=50, reason="12 ticks late"),
    m.Step(ticks=3),
    m.Observe(since_tick=60),
    _frame(),
    m.GetTicks(start_tick=-27, stop_tick=30, rate_hz=20, include_reference=True),
    _range(),
    m.Look.of(_frame(), _range(3, references=3, impulses=3)),
    m.Impulse(body="pelvis", impulse_w_ns=(10.0, 0.0, 0.0)),
    m.TakeSnapshot(),
    m.Snapshot(tick=5, meta={"scene": "flat"}, state=_ramp(4, dtype="<f8"), buffers=_ramp(3, dtype="|u1")),
    m.Restore(tick=5, meta={"scene": "flat"}, state=_ramp(4, dtype="<f8"), buffers=_ramp(3, dtype="|u1")),
    m.Render(start_tick=0, stop_tick=30, captions=[(0, "walk")]),
    m.Video(renderer="drawn", note="no GL", mp4=_ramp(8, dtype="|u1")),
)  # fmt: skip


def sample_envelope(message: Message) -> c.Envelope:
    """The same envelope for every sample."""
    return c.Envelope(
        type=message.type, message_id="0123456789abcdef", character_id="walker", sequence=4,
        deadline_unix_s=1000.5, trace_id="trace", instance_id="f" * 32,
    )  # fmt: skip


def packed(frames: list[bytes]) -> bytes:
    """Frames in one file: their number, then each one's length and bytes (little-endian u32)."""
    return struct.pack("<I", len(frames)) + b"".join(struct.pack("<I", len(f)) + f for f in frames)


def unpacked(data: bytes) -> list[bytes]:
    """Inverse of `packed`."""
    (count,), at, frames = struct.unpack_from("<I", data), 4, []
    for _ in range(count):
        (size,) = struct.unpack_from("<I", data, at)
        frames.append(data[at + 4 : at + 4 + size])
        at += 4 + size
    return frames


if __name__ == "__main__":
    GOLDEN.mkdir(exist_ok=True)
    for sample in SAMPLES:
        (GOLDEN / f"{sample.type}.bin").write_bytes(packed(encode(sample_envelope(sample), sample)))
