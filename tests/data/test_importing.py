"""Importing files: rates, axes and units that are said or assumed, bad files, names of outputs."""

from __future__ import annotations

import json
import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner, Result

from orchestrator.cli import main as cli
from shared.data.importer import import_path, load_clip
from shared.data.reading import read_all
from shared.errors import InvalidInputError
from shared.motion.io.files import read_motion
from shared.motion.io.options import ReadOptions
from tests.data.walks import JOINTS, Spelling, local_rotations, plain

FRAMES = 60
_SMPL = {"LeftUpLeg": 1, "RightUpLeg": 2, "LeftLeg": 4, "RightLeg": 5, "LeftArm": 16, "RightArm": 17}


def smpl(up: str = "z", joints: int = 52) -> dict[str, Any]:
    """Arrays of a walk of 60 frames at 30 Hz along +X of a Z-up world, or along +Z of a Y-up one."""
    poses = np.zeros((FRAMES, joints, 3))
    for name, rotations in local_rotations().items():
        poses[:, _SMPL[name]] = Rotation.from_matrix(rotations[:FRAMES]).as_rotvec()
    way, high = 1.1 * np.arange(FRAMES) / 30.0, np.full(FRAMES, 0.95)
    if up == "z":
        # The body's own Z goes to the world's X, its Y to Z.
        poses[:, 0] = Rotation.from_matrix([[0, 0, 1], [1, 0, 0], [0, 1, 0]]).as_rotvec()
        trans = np.stack([way, 0 * way, high], axis=-1)
    else:
        trans = np.stack([0 * way, high, way], axis=-1)
    return {"poses": poses.reshape(FRAMES, -1), "trans": trans, "mocap_framerate": np.float64(30.0)}


def saved(path: Path, arrays: dict[str, Any], **changes: Any) -> Path:
    merged = {k: v for k, v in (arrays | changes).items() if v is not None}
    np.savez(path, **merged)
    return path


@pytest.fixture
def walk_xyz(tmp_path: Path) -> np.ndarray:
    return load_clip(saved(tmp_path / "base.npz", smpl()))[0].positions_w_m


ASF_PARENT = {"lhipjoint": "root", "lfemur": "lhipjoint", "ltibia": "lfemur", "lfoot": "ltibia"}
ASF_BONES = {
    "lhipjoint": ("1 -0.3 0", 1.6),
    "lfemur": ("0 -1 0", 7.2),
    "ltibia": ("0 -1 0", 7.3),
    "lfoot": ("0 0 1", 2),
}


def asf(angle: str = "deg", names: dict[str, str] | None = None) -> str:
    """A skeleton of two legs and a spine; one bone's axes are turned by a quarter."""
    names = names or {}
    quarter = "90" if angle == "deg" else f"{np.pi / 2:.8f}"
    parts = [f":units\n length 0.45\n angle {angle}\n:root\n order TX TY TZ RX RY RZ\n axis XYZ\n orientation 0 0 0\n"]
    parts.append(":bonedata\n")
    bones = {"lowerback": ("0 1 0", 8.0, "", "0 0 0"), "head": ("0 1 0", 3.0, "", "0 0 0")}
    links = {"lowerback": "root", "head": "lowerback"}
    for side in "lr":
        for name, (direction, length) in ASF_BONES.items():
            x, y, z = direction.split()
            mine = side + name[1:]
            x = x if side == "l" else str(-float(x))
            dof = "" if "hip" in name else "dof rx\n"
            # A turn about X of axes turned about X is the same turn.
            bones[mine] = (f"{x} {y} {z}", length, dof, f"{quarter} 0 0" if name == "ltibia" else "0 0 0")
            links[mine] = ASF_PARENT[name] if ASF_PARENT[name] == "root" else side + ASF_PARENT[name][1:]
    for name, (direction, length, dof, axis) in bones.items():
        shown = names.get(name, name)
        parts.append(f"begin\n name {shown}\n direction {direction}\n length {length}\n axis {axis} XYZ\n{dof}end\n")
    parts.append(":hierarchy\n begin\n")
    parts += [f" {names.get(p, p)} {names.get(c, c)}\n" for c, p in links.items()]
    return "".join(parts) + " end\n"


def amc(head: str = ":DEGREES", scale: float = 1.0, names: dict[str, str] | None = None) -> str:
    names = names or {}
    lines = ["#!OML:ASF", ":FULLY-SPECIFIED", *head.split("\n")]
    for k in range(FRAMES):
        swing = 25 * np.sin(2 * np.pi * k / 30) * scale
        bend = (15 + 15 * np.cos(2 * np.pi * k / 30)) * scale
        lines += [str(k + 1), f"root 0 16 {k * 0.6:.4f} 0 0 0"]
        lines += [f"{names.get(n, n)} {v:.8f}" for n, v in
                  (("lfemur", -swing), ("rfemur", swing), ("ltibia", bend), ("rtibia", bend),
                   ("lfoot", 0.0), ("rfoot", 0.0))]  # fmt: skip
    return "\n".join(lines) + "\n"


def asf_amc(folder: Path, skeleton: str, motion: str, names: tuple[str, str] = ("01.asf", "01_01.amc")) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / names[0]).write_text(skeleton)
    (folder / names[1]).write_text(motion)
    return folder / names[1]


# ---- npz


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


# ---- ASF + AMC


def test_amc_has_no_rate_and_it_is_said(tmp_path: Path) -> None:
    path = asf_amc(tmp_path / "a", asf(), amc())
    raw = read_motion(path)
    assert raw.fps == 30.0 and "30 frames per second assumed" in raw.warnings[0]
    fast = read_motion(path, ReadOptions(fps=120.0))
    assert fast.fps == 120.0 and not any("rate" in warning for warning in fast.warnings)
    assert read_motion(asf_amc(tmp_path / "b", asf(), amc(":DEGREES\n:SAMPLES-PER-SECOND 60"))).fps == 60.0


def test_radians_and_degrees_are_the_same_motion(tmp_path: Path) -> None:
    want = read_motion(asf_amc(tmp_path / "a", asf(), amc())).positions_w_m
    rad = np.pi / 180
    for k, (skeleton, motion) in enumerate(
        [
            (asf("rad"), amc("", rad)),
            (asf("rad"), amc(":DEGREES")),
            (asf("deg"), amc(":RADIANS", rad)),
            (asf("deg"), amc("")),
            (asf("rad"), amc(":radians", rad)),
        ]
    ):
        got = read_motion(asf_amc(tmp_path / f"b{k}", skeleton, motion)).positions_w_m
        np.testing.assert_allclose(got, want, atol=1e-5)


@pytest.mark.parametrize("names", [("01.ASF", "01_01.AMC"), ("A.ASF", "a_walk.amc"), ("other.Asf", "01_01.Amc")])
def test_upper_and_lower_case_are_the_same(tmp_path: Path, names: tuple[str, str]) -> None:
    path = asf_amc(tmp_path / "a", asf(), amc(), names)
    assert len(read_motion(path)) == FRAMES
    assert len(import_path(tmp_path / "a", tmp_path / "out")) == 1


def test_the_longest_name_of_a_skeleton_that_fits_is_taken(tmp_path: Path) -> None:
    path = asf_amc(tmp_path / "a", asf(), amc(), ("01_0.asf", "01_01.amc"))
    (path.parent / "0.asf").write_text("not one")
    (path.parent / "02.asf").write_text("not one")
    assert len(read_motion(path)) == FRAMES
    (path.parent / "01_0.asf").unlink()
    (path.parent / "0.asf").unlink()
    (path.parent / "03.asf").write_text("not one")
    with pytest.raises(InvalidInputError, match=r"no ASF skeleton for it.*02.asf, 03.asf"):
        read_motion(path)


def test_bones_of_another_convention_are_found(tmp_path: Path) -> None:
    """Acclaim joints are the far ends of bones; where a thigh begins its parent ends."""
    names = {"lhipjoint": "LHip", "lfemur": "LeftThigh", "ltibia": "LeftShin", "lfoot": "LeftFoot"}
    names |= {"rhipjoint": "RHip", "rfemur": "RightThigh", "rtibia": "RightShin", "rfoot": "RightFoot"}
    want = read_motion(asf_amc(tmp_path / "a", asf(), amc()))
    got = read_motion(asf_amc(tmp_path / "b", asf(names=names), amc(names=names)))
    for mark in ("left_hip", "left_knee", "left_ankle", "right_knee"):
        at = got.positions_w_m[:, got.landmarks()[mark]]
        np.testing.assert_allclose(at, want.positions_w_m[:, want.landmarks()[mark]], atol=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("lfoot 0.00000000\n", "", "frame 1 has no lfoot|lfoot does not occur"),
        ("root 0 16 0.6000 0 0 0", "root 0 16 0.6000 0 0", r"line 13: root has 5 values where its skeleton has 6"),
        ("root 0 16 0.6000 0 0 0", "root 0 16 nan 0 0 0", r"line 13: a value of root is not finite"),
        ("root 0 16 0.6000 0 0 0", "root 0 16 x 0 0 0", r"line 13: .* not a number"),
    ],
)
def test_wrong_rows_of_an_amc_are_named(tmp_path: Path, old: str, new: str, what: str) -> None:
    path = asf_amc(tmp_path / "a", asf(), amc().replace(old, new, 1))
    with pytest.raises(InvalidInputError, match=what):
        read_motion(path)


def test_an_amc_that_is_cut_off_is_refused(tmp_path: Path) -> None:
    path = asf_amc(tmp_path / "a", asf(), "\n".join(amc().splitlines()[:-3]))
    with pytest.raises(InvalidInputError, match="cut off"):
        read_motion(path)


def test_a_wrong_row_of_an_asf_is_named(tmp_path: Path) -> None:
    path = asf_amc(tmp_path / "a", asf().replace("length 7.2", "length long", 1), amc())
    with pytest.raises(InvalidInputError, match=r"^01.asf: line \d+: 'length long'"):
        read_motion(path)


# ---- the command


def command(*arguments: object) -> Result:
    return CliRunner().invoke(cli.app, ["data", "import", *map(str, arguments)])


@pytest.fixture
def recordings(tmp_path: Path) -> Path:
    """A good BVH, an empty one, a broken npz, a file without motion, and a still of one frame."""
    folder = tmp_path / "in"
    folder.mkdir()
    (folder / "b_walk.bvh").write_text(plain())
    (folder / "a_empty.bvh").write_text("")
    (folder / "c_broken.npz").write_bytes(saved(tmp_path / "whole.npz", smpl()).read_bytes()[:3000])
    np.savez(folder / "d_shape.npz", betas=np.zeros(10), gender=np.array("neutral"))
    (folder / "e_still.bvh").write_text("\n".join(plain().splitlines()[:-89]).replace("Frames: 90", "Frames: 1"))
    return folder


def test_a_row_a_file_then_a_summary_and_the_json(recordings: Path, tmp_path: Path) -> None:
    shown = command(recordings, tmp_path / "out", "--json", tmp_path / "deep" / "result.json")
    lines = shown.stdout.splitlines()
    assert shown.exit_code == 1
    assert lines[0] == "error: a_empty.bvh: the file is empty"
    assert lines[1].startswith("b_walk.bvh  30 fps  3.00 s  up Y  unit cm  skeleton HumanIK  travelled 3.4")
    assert lines[2].startswith("error: c_broken.npz: not a readable npz")
    assert lines[3].startswith("warning: d_shape.npz: left out: no motion in it (its arrays: betas, gender)")
    assert lines[4].startswith("warning: e_still.bvh: left out: 1 frames are too few")
    assert lines[-1] == "1 imported, 2 left out, 2 could not be read"
    result = json.loads((tmp_path / "deep" / "result.json").read_text())
    assert (result["imported"], result["left_out"], result["refused"]) == (1, 2, 2)
    good = result["files"][1]
    assert (good["fps"], good["seconds"], good["up"], good["unit_m"], good["skeleton"]) == (30, 3, "y", 0.01, "HumanIK")
    assert good["frames"] == 90
    assert good["travelled_m"] == pytest.approx(3.46, abs=0.02) and good["warnings"] == []


def test_what_is_left_out_for_a_reason_is_no_error(recordings: Path, tmp_path: Path) -> None:
    for name in ("a_empty.bvh", "c_broken.npz"):
        (recordings / name).unlink()
    assert command(recordings, tmp_path / "out").exit_code == 0


def test_options_reach_the_readers(tmp_path: Path) -> None:
    (tmp_path / "map.json").write_text(json.dumps({"left_hip": "Bein"}))
    path = tmp_path / "walk.bvh"
    path.write_text(Spelling(names={"LeftUpLeg": "Bein"}, frame_time="33.333").text())
    arguments = ("--fps", "60", "--up", "Y", "--unit", "0.02", "--joints", tmp_path / "map.json")
    shown = command(path, tmp_path / "out", *arguments)
    assert shown.exit_code == 0, shown.output
    assert shown.stdout.startswith("walk.bvh  60 fps  1.50 s  up Y  unit 0.02 m  skeleton map")
    assert "warning: walk.bvh: Frame Time 33.333 s means 0.03 frames per second; read at 60 as asked" in shown.stdout


@pytest.mark.parametrize(
    "wrong", [("--fps", "3000"), ("--fps", "nan"), ("--up", "w"), ("--unit", "0"), ("--joints", "nowhere.json")]
)
def test_wrong_options_are_one_sentence(tmp_path: Path, wrong: tuple[str, str]) -> None:
    (tmp_path / "walk.bvh").write_text(plain())
    shown = command(tmp_path / "walk.bvh", tmp_path / "out", *wrong)
    assert shown.exit_code == 1
    assert "invalid_input" in shown.output and "Traceback" not in shown.output


def test_the_source_folder_as_output_keeps_every_input(tmp_path: Path) -> None:
    for name in ("walk.bvh", "walk.npz"):
        if name.endswith("bvh"):
            (tmp_path / name).write_text(plain())
        else:
            saved(tmp_path / name, smpl())
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    for _ in range(2):
        shown = command(tmp_path, tmp_path)
        assert shown.exit_code == 0
        assert "2 imported" in shown.stdout
        assert {name: (tmp_path / name).read_bytes() for name in before} == before
        made = sorted(p.name for p in tmp_path.iterdir() if p.name not in before)
        assert made == ["walk_bvh.bvh", "walk_bvh.npz", "walk_npz.bvh", "walk_npz.npz"]


def test_a_file_into_its_own_folder_keeps_it(tmp_path: Path) -> None:
    (tmp_path / "walk.bvh").write_text(plain())
    assert command(tmp_path / "walk.bvh", tmp_path).exit_code == 0
    assert (tmp_path / "walk.bvh").read_text() == plain()
    assert (tmp_path / "walk_bvh.bvh").is_file()


def test_files_of_one_name_have_an_output_each(tmp_path: Path) -> None:
    source = tmp_path / "in"
    (source / "a").mkdir(parents=True)
    for name in ("walk.bvh", "a/b.bvh", "a_b.bvh", "WALK.BVH"):
        (source / name).write_text(plain())
    saved(source / "walk.npz", smpl())
    shown = command(source, tmp_path / "out")
    assert shown.exit_code == 0
    outputs = sorted(p.name.lower() for p in (tmp_path / "out").glob("*.npz"))
    assert len(outputs) == len(set(outputs)) == len(list(source.rglob("*.*")))


def test_importing_again_replaces_and_another_file_of_the_name_does_not(tmp_path: Path) -> None:
    for folder in ("day1", "day2"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "walk.bvh").write_text(plain())
    out = tmp_path / "out"
    for folder in ("day1", "day1", "day2", "day2"):
        assert command(tmp_path / folder, out).exit_code == 0
    assert sorted(p.name for p in out.iterdir()) == ["walk.bvh", "walk.npz", "walk_bvh.bvh", "walk_bvh.npz"]


def test_a_persons_own_file_in_the_output_folder_is_kept(tmp_path: Path) -> None:
    (tmp_path / "walk.bvh").write_text(plain())
    out = tmp_path / "out"
    out.mkdir()
    (out / "walk.bvh").write_text("mine")
    assert command(tmp_path / "walk.bvh", out).exit_code == 0
    assert (out / "walk.bvh").read_text() == "mine"


def test_an_output_folder_within_the_recordings_is_no_recording(tmp_path: Path) -> None:
    (tmp_path / "walk.bvh").write_text(plain())
    for _ in range(2):
        assert "1 imported" in command(tmp_path, tmp_path / "out").stdout


def test_what_was_imported_reads_as_itself(tmp_path: Path) -> None:
    (tmp_path / "walk.bvh").write_text(plain())
    import_path(tmp_path / "walk.bvh", tmp_path / "out")
    (entry,) = import_path(tmp_path / "out", tmp_path / "again")  # its npz and its BVH are one
    assert entry["skeleton"] == "SMPL" and "error" not in entry
    raw = read_motion(tmp_path / "out" / "walk.npz")
    assert raw.family == "motionloop"
    np.testing.assert_allclose(raw.positions_w_m, load_clip(tmp_path / "walk.bvh")[0].positions_w_m, atol=1e-5)


@pytest.mark.parametrize("where", ["file", "file/below", "dev/null/out"])
def test_an_output_path_that_cannot_be_made_is_one_sentence(tmp_path: Path, where: str) -> None:
    (tmp_path / "walk.bvh").write_text(plain())
    (tmp_path / "file").write_text("x")
    out = Path("/") / where if where.startswith("dev") else tmp_path / where
    shown = command(tmp_path / "walk.bvh", out, "--json", tmp_path / "result.json")
    assert shown.exit_code == 1
    assert str(out) in shown.output.replace("\n", "") and "Traceback" not in shown.output
    assert "file" in json.loads((tmp_path / "result.json").read_text())["error"]


@pytest.mark.parametrize("json_file", [".", "walk.bvh/result.json"])
def test_a_json_path_that_cannot_be_written_is_told_before_the_work(tmp_path: Path, json_file: str) -> None:
    (tmp_path / "walk.bvh").write_text(plain())
    shown = command(tmp_path / "walk.bvh", tmp_path / "out", "--json", tmp_path / json_file)
    assert shown.exit_code == 1
    assert "invalid_input" in shown.output and not (tmp_path / "out").exists()


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_a_file_that_may_not_be_read_is_named(tmp_path: Path) -> None:
    (tmp_path / "walk.bvh").write_text(plain())
    (tmp_path / "walk.bvh").chmod(0)
    shown = command(tmp_path / "walk.bvh", tmp_path / "out")
    assert shown.exit_code == 1 and "error: walk.bvh: cannot be opened" in shown.output


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (ReadOptions(up="z"), "--up, --unit"),
        (ReadOptions(up="x"), "hardly ever upright"),
        (ReadOptions(fps=1000), "m/s"),
    ],
)
def test_a_wrong_axis_or_rate_shows_in_a_warning(tmp_path: Path, options: ReadOptions, said: str) -> None:
    (tmp_path / "walk.bvh").write_text(plain())
    (entry,) = import_path(tmp_path / "walk.bvh", tmp_path / "out", options)
    assert any(said in warning for warning in entry["warnings"]), entry


_SHORT = "\n".join(plain().splitlines()[:-80]).replace("Frames: 90", "Frames: 10") + "\n"
_BITS = ("{", "}", "nan", "-", "1e300", "JOINT x", "0", "\n", " ", "MOTION\n", "CHANNELS 2 Xrotation", "ROOT y\n{", "")


@given(data=st.data())
def test_whatever_is_broken_in_a_file_it_is_read_or_refused_by_name(data: st.DataObject) -> None:
    kind = data.draw(st.sampled_from(["bvh", "asf", "amc"]))
    text = {"bvh": _SHORT, "asf": asf(), "amc": amc()}[kind]
    at = data.draw(st.integers(0, len(text) - 1))
    cut = data.draw(st.sampled_from([0, 1, 5, 30, len(text)]))
    text = text[:at] + data.draw(st.sampled_from(_BITS)) + text[at + cut :]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        path = asf_amc(folder, asf(), amc())
        path = {"bvh": folder / "a.bvh", "asf": folder / "01.asf", "amc": path}[kind]
        path.write_text(text)
        (outcome,) = read_all([path.with_name("01_01.amc") if kind == "asf" else path], folder)
    assert outcome.loaded is not None or outcome.error or outcome.left_out


def test_a_skeleton_in_one_point_is_refused_and_the_next_is_read(tmp_path: Path) -> None:
    source = tmp_path / "in"
    source.mkdir()
    flat = plain()
    for _, _, (x, y, z) in JOINTS:
        flat = flat.replace(f"OFFSET {x:.5f} {y:.5f} {z:.5f}", "OFFSET 0 0 0")
    (source / "a.bvh").write_text(flat)
    (source / "b.bvh").write_text(plain())
    shown = command(source, tmp_path / "out")
    assert shown.exit_code == 1
    assert "error: a.bvh: the bones of the legs have no length" in shown.output and "1 imported" in shown.output
