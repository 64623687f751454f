"""A recording in the formats that are offered: npz, BVH, CSV, glTF binary. Axes and units: docs/exports.md."""

from __future__ import annotations

import csv
import io
import tempfile
from pathlib import Path
from typing import Literal

import numpy as np

from orchestrator.export.gltf import to_glb
from orchestrator.store.recordings import Recording, to_npz
from shared.motion.clip import MotionClip
from shared.motion.io.bvh import write_bvh
from shared.motion.skeleton import CANONICAL
from shared.protocol.messages import TICK_HZ

Format = Literal["npz", "bvh", "csv", "glb"]
Unit = Literal["m", "cm"]
MEDIA_TYPES: dict[Format, str] = {
    "npz": "application/octet-stream",
    "bvh": "text/plain",
    "csv": "text/csv",
    "glb": "model/gltf-binary",
}


def exported(recording: Recording, kind: Format, unit: Unit = "m") -> bytes:
    """The recording as a file; `unit` counts for BVH only."""
    if kind == "npz":
        return to_npz(recording)
    if kind == "bvh":
        return to_bvh(recording, unit)
    return to_csv(recording) if kind == "csv" else to_glb(recording)


def clip_of(recording: Recording) -> MotionClip:
    """The simulated bodies as a clip at 30 fps: their orientations, not IK."""
    arrays = recording.arrays
    return MotionClip.from_bodies(arrays["body_pos_w_m"], arrays["body_quat_w"], TICK_HZ, recording.skeleton.id)


def to_bvh(recording: Recording, unit: Unit = "m") -> bytes:
    """BVH text at 30 fps, Y up, facing +Z; in metres it is to scale in Blender without any setting."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "motion.bvh"
        write_bvh(path, clip_of(recording), unit_m=1.0 if unit == "m" else 0.01)
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
