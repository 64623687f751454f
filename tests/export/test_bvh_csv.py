"""BVH and CSV read by other people's readers and compared with the recording."""

from __future__ import annotations

import csv
from pathlib import Path

import bvhio
import numpy as np
import pytest

from orchestrator.client import Motion
from shared.motion.rotations import matrix_from_quat, rotvec_from_matrix

BVH_AXES = [1, 2, 0]
"""The file's x, y, z are our Y (left), Z (up), X (forward)."""


def frames_of(motion: Motion) -> list[int]:
    return [*range(0, len(motion), 20), len(motion) - 1]


def to_bvh_axes(rotations: np.ndarray) -> np.ndarray:
    return rotations[..., BVH_AXES, :][..., :, BVH_AXES]


@pytest.mark.parametrize(("name", "unit_m"), [("motion.bvh", 1.0), ("centimetres.bvh", 0.01)])
def test_a_bvh_has_the_recordings_joint_positions_within_a_millimetre(
    folder: Path, motion: Motion, name: str, unit_m: float
) -> None:
    root = bvhio.readAsHierarchy(str(folder / name))
    for frame in frames_of(motion):
        root.loadPose(frame)
        seen = {joint.Name: np.array(joint.PositionWorld) * unit_m for joint, _, _ in root.layout()}
        assert seen.keys() == set(motion.joints)
        wanted = motion.positions_w_m[frame][:, BVH_AXES]
        for joint, place in zip(motion.joints, wanted, strict=True):
            assert np.linalg.norm(seen[joint] - place) < 0.001, (frame, joint)


def test_a_bvh_has_the_recordings_rotations_within_a_tenth_of_a_degree(folder: Path, motion: Motion) -> None:
    root = bvhio.readAsHierarchy(str(folder / "motion.bvh"))

    def world() -> dict[str, np.ndarray]:
        return {joint.Name: matrix_from_quat(list(joint.RotationWorld)) for joint, _, _ in root.layout()}

    root.loadRestPose()
    rest = world()
    for frame in frames_of(motion):
        root.loadPose(frame)
        now = world()
        wanted = to_bvh_axes(matrix_from_quat(motion.quats_w[frame]))
        for joint, rotation in zip(motion.joints, wanted, strict=True):
            turned = now[joint] @ rest[joint].T  # since the T-pose
            angle = np.degrees(np.linalg.norm(rotvec_from_matrix(turned @ rotation.T)))
            assert angle < 0.1, (frame, joint)


def test_a_bvh_keeps_the_time_and_stands_upright(folder: Path, motion: Motion) -> None:
    file = bvhio.readAsBvh(str(folder / "motion.bvh"))
    assert file.FrameCount == len(motion)
    assert pytest.approx(1 / 30, abs=1e-6) == file.FrameTime
    root = bvhio.readAsHierarchy(str(folder / "motion.bvh"))
    root.loadPose(0)
    places = {joint.Name: np.array(joint.PositionWorld) for joint, _, _ in root.layout()}
    assert places["head"][1] - places["left_foot"][1] > 1.4
    assert places["left_wrist"][0] > places["right_wrist"][0]


def test_a_csv_has_the_recordings_numbers(folder: Path, motion: Motion) -> None:
    with (folder / "motion.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(motion)
    assert [int(row["tick"]) for row in rows] == list(range(motion.start_tick, motion.start_tick + len(motion)))
    assert np.allclose([float(row["time_s"]) for row in rows], motion.times_s, atol=1e-4)
    for joint in motion.joints:
        places = np.array([[float(row[f"{joint}_{axis}_m"]) for axis in "xyz"] for row in rows])
        assert np.abs(places - motion.joint(joint)).max() < 1e-5 + 1e-9
    assert [bool(int(row["fallen"])) for row in rows] == motion.fallen.tolist()
    assert np.allclose([float(row["tracking_error_m"]) for row in rows], motion.tracking_error_m, atol=1e-5)
