"""BVH, ASF + AMC and SMPL files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from shared.errors import InvalidInputError
from shared.motion.clip import MotionClip
from shared.motion.ik import standing_clip
from shared.motion.io.asfamc import read_asf_amc
from shared.motion.io.bvh import read_bvh, write_bvh
from shared.motion.io.landmarks import find_landmarks
from shared.motion.io.names import normalise
from shared.motion.io.raw import euler_matrix
from shared.motion.io.smpl import read_smpl_npz
from shared.motion.kinematics import forward_kinematics
from shared.motion.rotations import matrix_from_rotvec, matrix_to_6d
from shared.motion.skeleton import CANONICAL


def _random_clip(frames: int, seed: int) -> MotionClip:
    rng = np.random.default_rng(seed)
    local = matrix_from_rotvec(rng.normal(0.0, 0.6, (frames, len(CANONICAL), 3)))
    root = rng.normal(0.0, 1.0, (frames, 3)) + [0.0, 0.0, 2.0]
    positions, _ = forward_kinematics(CANONICAL, root, local)
    return MotionClip(positions, matrix_to_6d(local), 30.0)


def test_written_bvh_reads_back_to_a_tenth_of_a_millimetre(tmp_path: Path) -> None:
    clip = _random_clip(12, 3)
    write_bvh(tmp_path / "a.bvh", clip)
    raw = read_bvh(tmp_path / "a.bvh", up="y", unit_m=0.01)
    columns = [raw.names.index(name) for name in CANONICAL.names]
    assert raw.fps == 30.0
    np.testing.assert_allclose(raw.positions_w_m[:, columns], clip.positions_w_m, atol=1e-4)


def test_written_bvh_is_y_up_in_centimetres_facing_z(tmp_path: Path) -> None:
    write_bvh(tmp_path / "a.bvh", standing_clip(2, 30.0))
    lines = (tmp_path / "a.bvh").read_text().splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith("Frame Time"))
    x, y, z = (float(v) for v in lines[start + 1].split()[:3])
    assert (x, z) == (0.0, 0.0)
    assert y == pytest.approx(100 * CANONICAL.root_height_m, abs=1e-3)
    # The left hip is along the file's +X, the toes along its +Z.
    hip = lines.index("  JOINT left_hip")
    assert float(lines[hip + 2].split()[1]) == pytest.approx(8.75)


def test_hand_computed_bvh(tmp_path: Path) -> None:
    """Root turned 90 degrees about Y (up): a child at +Z of the file lands at +X of the file, +Y of the world."""
    names = ("LeftUpLeg", "LeftLeg", "LeftFoot", "RightUpLeg", "RightLeg", "RightFoot")
    joints = ""
    for side in ("Left", "Right"):
        x = 0.1 if side == "Left" else -0.1
        joints += (
            f"JOINT {side}UpLeg\n{{\nOFFSET {x} 0 0\nCHANNELS 1 Xrotation\n"
            f"JOINT {side}Leg\n{{\nOFFSET 0 -0.4 0\nCHANNELS 1 Xrotation\n"
            f"JOINT {side}Foot\n{{\nOFFSET 0 -0.4 0\nCHANNELS 1 Xrotation\n"
            "End Site\n{\nOFFSET 0 0 0.2\n}\n}\n}\n}\n"
        )
    text = (
        "HIERARCHY\nROOT Hips\n{\nOFFSET 0 0 0\n"
        "CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation\n"
        + joints
        + "}\nMOTION\nFrames: 1\nFrame Time: 0.05\n0 1 0 0 0 90 "
        + "0 " * len(names)
        + "\n"
    )
    path = tmp_path / "h.bvh"
    path.write_text(text)
    raw = read_bvh(path, up="y", unit_m=1.0)
    assert raw.fps == 20.0
    toe = raw.positions_w_m[0, raw.names.index("LeftFoot_end")]
    # In the file: hip (0.1,1,0) turned by 90 about Y is (0,1,-0.1); the foot is 0.8 below, its tip 0.2 along +X.
    np.testing.assert_allclose(toe, [-0.1, 0.2, 0.2], atol=1e-12)


@pytest.mark.parametrize(
    "text", ["", "HIERARCHY\n", "garbage\n", "HIERARCHY\nROOT a\n{\nOFFSET 0 0 0\n}\nMOTION\nFrames: x\n"]
)
def test_malformed_bvh_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "x.bvh").write_text(text)
    with pytest.raises(InvalidInputError):
        read_bvh(tmp_path / "x.bvh")


_ASF = (
    """:units
 length 0.45
 angle deg
:root
 order TX TY TZ RX RY RZ
 axis XYZ
 position 0 0 0
 orientation 0 0 0
:bonedata
"""
    + "".join(
        f"begin\n id 1\n name {n}\n direction {d}\n length {length}\n axis 0 0 0 XYZ\n{dof}end\n"
        for n, d, length, dof in (
            ("lhipjoint", "1 0 0", 1.5, ""),
            ("lfemur", "0 -1 0", 7.0, "dof rx ry rz\n"),
            ("ltibia", "0 -1 0", 7.0, "dof rx\n"),
            ("rhipjoint", "-1 0 0", 1.5, ""),
            ("rfemur", "0 -1 0", 7.0, "dof rx ry rz\n"),
            ("rtibia", "0 -1 0", 7.0, "dof rx\n"),
        )
    )
    + (
        ":hierarchy\n begin\n root lhipjoint rhipjoint\n lhipjoint lfemur\n lfemur ltibia\n"
        " rhipjoint rfemur\n rfemur rtibia\n end\n"
    )
)


def test_hand_computed_asf_amc(tmp_path: Path) -> None:
    """A thigh raised by 90 degrees about -X points forward; the shank hangs when its knee bends back by 90."""
    (tmp_path / "s.asf").write_text(_ASF)
    (tmp_path / "s_01.amc").write_text(
        ":FULLY-SPECIFIED\n:DEGREES\n1\nroot 0 14 0 0 0 0\nlfemur -90 0 0\nltibia 90\nrfemur 0 0 0\nrtibia 0\n"
    )
    raw = read_asf_amc(tmp_path / "s.asf", tmp_path / "s_01.amc", 30.0)
    unit = 0.0254 / 0.45
    at = {name: raw.positions_w_m[0, i] / unit for i, name in enumerate(raw.names)}
    np.testing.assert_allclose(at["root"], [0, 0, 14], atol=1e-9)
    np.testing.assert_allclose(at["lhipjoint"], [0, 1.5, 14], atol=1e-9)
    np.testing.assert_allclose(at["lfemur"], [7, 1.5, 14], atol=1e-9)
    np.testing.assert_allclose(at["ltibia"], [7, 1.5, 7], atol=1e-9)
    np.testing.assert_allclose(at["rtibia"], [0, -1.5, 0], atol=1e-9)


def test_smpl_identity_stands_and_faces_x(tmp_path: Path) -> None:
    """SMPL's zero pose is Y up facing +Z; AMASS puts it upright with a quarter turn about X."""
    poses = np.zeros((4, 72))
    poses[:, 0] = np.pi / 2
    np.savez(tmp_path / "m.npz", poses=poses, trans=np.zeros((4, 3)), mocap_framerate=np.int64(60))
    raw = read_smpl_npz(tmp_path / "m.npz")
    head = raw.positions_w_m[0, raw.names.index("head")]
    ankle = raw.positions_w_m[0, raw.names.index("left_ankle")]
    assert raw.fps == 60.0
    assert head[2] > 0.4
    assert ankle[2] < -0.8
    np.savez(tmp_path / "bad.npz", poses=np.zeros((4, 10)), trans=np.zeros((4, 3)))
    with pytest.raises(InvalidInputError):
        read_smpl_npz(tmp_path / "bad.npz")


def test_euler_order_is_left_to_right() -> None:
    a = np.radians([30.0, 40.0])
    m = euler_matrix("zx", a)
    z = np.array([[np.cos(a[0]), -np.sin(a[0]), 0], [np.sin(a[0]), np.cos(a[0]), 0], [0, 0, 1]])
    x = np.array([[1, 0, 0], [0, np.cos(a[1]), -np.sin(a[1])], [0, np.sin(a[1]), np.cos(a[1])]])
    np.testing.assert_allclose(m, z @ x, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("LeftUpLeg", ("left", "upleg")),
        ("CC_Base_R_Thigh", ("right", "thigh")),
        ("mixamorig:RightForeArm", ("right", "forearm")),
        ("lShldr", ("left", "shldr")),
        ("right_ankle", ("right", "ankle")),
        ("head", ("", "head")),
    ],
)
def test_names_are_normalised(name: str, expected: tuple[str, str]) -> None:
    assert normalise(name) == expected


def test_landmarks_of_the_canonical_skeleton_are_its_own_joints() -> None:
    marks = find_landmarks(CANONICAL.names, CANONICAL.parents)
    for mark, joint in marks.items():
        assert CANONICAL.names[joint] == mark.replace("_toe", "_foot")


def test_a_skeleton_without_legs_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="left_hip"):
        find_landmarks(("root", "tail"), (-1, 0))
