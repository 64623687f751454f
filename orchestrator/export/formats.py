"""A recording as BVH and CSV."""

from __future__ import annotations

import csv
import io
import tempfile
from pathlib import Path

import numpy as np

from orchestrator.store.recordings import Recording
from shared.motion.clip import MotionClip
from shared.motion.io.bvh import write_bvh
from shared.motion.kinematics import local_from_global
from shared.motion.rotations import matrix_from_quat, matrix_to_6d
from shared.motion.skeleton import CANONICAL
from shared.protocol.messages import TICK_HZ


def clip_of(recording: Recording) -> MotionClip:
    """The simulated bodies as a clip at 30 fps: their orientations, not IK."""
    world = matrix_from_quat(recording.arrays["body_quat_w"])
    positions = np.asarray(recording.arrays["body_pos_w_m"], dtype=np.float64)
    return MotionClip(positions, matrix_to_6d(local_from_global(CANONICAL, world)), TICK_HZ, CANONICAL.id)


def to_bvh(recording: Recording) -> bytes:
    """BVH text at 30 fps."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "motion.bvh"
        write_bvh(path, clip_of(recording))
        return path.read_bytes()


def to_csv(recording: Recording) -> bytes:
    """One line a tick: tick, time_s, x/y/z of every joint in metres, tracking error, fallen."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    columns = [f"{name}_{axis}_m" for name in CANONICAL.names for axis in "xyz"]
    writer.writerow(["tick", "time_s", *columns, "tracking_error_m", "fallen"])
    positions = np.asarray(recording.arrays["body_pos_w_m"], dtype=np.float64).reshape(len(recording), -1)
    errors = np.asarray(recording.arrays["tracking_error_m"], dtype=np.float64)
    fallen = np.asarray(recording.arrays["fallen"], dtype=np.int64)
    for i, row in enumerate(positions):
        tick = recording.start_tick + i
        numbers = [f"{value:.5f}" for value in row]
        writer.writerow([tick, f"{tick / TICK_HZ:.4f}", *numbers, f"{errors[i]:.5f}", int(fallen[i])])
    return out.getvalue().encode()
