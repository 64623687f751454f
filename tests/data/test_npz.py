"""SMPL files: rates, axes, parts, and what is refused by name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from shared.data.importer import load_clip
from shared.errors import InvalidInputError
from shared.motion.io.files import read_motion
from shared.motion.io.options import ReadOptions
from tests.data.captures import FRAMES, saved, smpl


@pytest.fixture
def walk_xyz(tmp_path: Path) -> np.ndarray:
    return load_clip(saved(tmp_path / "base.npz", smpl()))[0].positions_w_m


@pytest.mark.parametrize(
    "rate", [np.float64(30.0), np.array([30.0]), np.array([[30]]), np.array("30"), np.array(30, dtype=np.int16)]
)
@pytest.mark.parametrize("key", ["mocap_framerate", "mocap_frame_rate", "fps"])
def test_rates_of_any_shape_are_read(tmp_path: Path, key: str, rate: Any) -> None:
    raw = read_motion(saved(tmp_path / "a.npz", smpl(), **{"mocap_framerate": None, key: rate}))
    assert raw.fps == 30.0 and raw.warnings == ()


@pytest.mark.parametrize(
    "rate", [np.nan, np.inf, 0.0, -30.0, 0.033, 4.9, 1001.0, np.array([30.0, 60.0]), np.array("fast")]
)
def test_rates_that_are_none_are_refused_by_name(tmp_path: Path, rate: Any) -> None:
    path = saved(tmp_path / "a.npz", smpl(), mocap_framerate=rate)
    with pytest.raises(InvalidInputError, match=r"^a.npz: mocap_framerate"):
        read_motion(path)


def test_a_given_rate_replaces_one_that_is_none(tmp_path: Path) -> None:
    path = saved(tmp_path / "a.npz", smpl(), mocap_framerate=np.nan)
    assert read_motion(path, ReadOptions(fps=60.0)).fps == 60.0


def test_a_missing_rate_is_assumed_and_said(tmp_path: Path) -> None:
    raw = read_motion(saved(tmp_path / "a.npz", smpl(), mocap_framerate=None))
    assert raw.fps == 30.0
    assert raw.warnings == ("no frame rate in the file: 30 frames per second assumed (--fps says otherwise)",)


def test_parts_of_smpl_x_are_put_together(tmp_path: Path, walk_xyz: np.ndarray) -> None:
    arrays = smpl()
    poses = arrays["poses"]
    for keys in (("root_orient", "pose_body", "trans"), ("global_orient", "body_pose", "transl")):
        parts = dict(zip(keys, (poses[:, :3], poses[:, 3:66], arrays["trans"]), strict=True))
        path = saved(tmp_path / "x.npz", parts, mocap_frame_rate=np.float64(30), gender=np.array("neutral"))
        np.testing.assert_allclose(load_clip(path)[0].positions_w_m, walk_xyz, atol=1e-3)


def test_poses_may_have_a_joint_axis(tmp_path: Path, walk_xyz: np.ndarray) -> None:
    arrays = smpl()
    path = saved(tmp_path / "x.npz", arrays, poses=arrays["poses"].reshape(FRAMES, -1, 3))
    np.testing.assert_allclose(load_clip(path)[0].positions_w_m, walk_xyz, atol=1e-3)


def test_y_up_smpl_is_the_same_walk_and_said(tmp_path: Path, walk_xyz: np.ndarray) -> None:
    path = saved(tmp_path / "y.npz", smpl("y"))
    raw = read_motion(path)
    assert raw.up == "y" and "held along Y" in raw.warnings[0]
    np.testing.assert_allclose(load_clip(path)[0].positions_w_m, walk_xyz, atol=1e-3)
    given = read_motion(path, ReadOptions(up="y"))
    assert given.warnings == ()
    np.testing.assert_allclose(given.positions_w_m, raw.positions_w_m)


@pytest.mark.parametrize("up", ["y", "z"])
def test_a_person_who_lies_half_the_time_does_not_turn_the_world(tmp_path: Path, up: str) -> None:
    """From lying on the back, head toward +Z (or +Y), to standing, in worlds with Y and with Z up."""
    fall = np.clip(np.linspace(90.0, -10.0, FRAMES), 0.0, None)
    arrays = smpl("y")
    lean = Rotation.from_euler("x", fall[:, None], degrees=True)  # Y up: leaning from +Y to +Z
    height = 0.15 + 0.8 * np.cos(np.radians(fall))
    trans = np.stack([0 * fall, height, 0 * fall], axis=-1)
    if up == "z":
        turn = Rotation.from_matrix([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
        lean, trans = turn * lean, turn.apply(trans)
    poses = np.zeros_like(arrays["poses"])
    poses[:, :3] = lean.as_rotvec()
    raw = read_motion(saved(tmp_path / "a.npz", arrays, poses=poses, trans=trans))
    assert raw.up == up
    height_of_head = raw.positions_w_m[:, raw.landmarks()["head"], 2]
    assert height_of_head[-1] - height_of_head[0] > 1.0


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"trans": np.zeros((5, 3))}, "60 poses but 5 places"),
        ({"poses": np.zeros((FRAMES, 10))}, r"poses \(60, 10\)"),
        ({"poses": np.full((FRAMES, 66), np.nan)}, "poses is not finite in frame 0"),
        ({"poses": np.array(["a"] * FRAMES)}, "poses holds no numbers"),
    ],
)
def test_wrong_arrays_are_named(tmp_path: Path, changes: dict[str, Any], what: str) -> None:
    with pytest.raises(InvalidInputError, match=what):
        load_clip(saved(tmp_path / "a.npz", smpl(), **changes))


@pytest.mark.parametrize("size", [0, 4, 100, 5000, -200])
def test_a_truncated_npz_is_refused_by_name(tmp_path: Path, size: int) -> None:
    whole = saved(tmp_path / "whole.npz", smpl()).read_bytes()
    (tmp_path / "cut.npz").write_bytes(whole[:size])
    with pytest.raises(InvalidInputError, match=r"^cut.npz: "):
        load_clip(tmp_path / "cut.npz")


def test_objects_in_an_npz_are_not_unpickled(tmp_path: Path) -> None:
    path = saved(tmp_path / "a.npz", smpl(), poses=np.array([{"x": 1}], dtype=object))
    with pytest.raises(InvalidInputError, match=r"^a.npz: not a readable npz"):
        load_clip(path)
