"""What exporters and people do to files beside the usual: each comes in right, or is refused in one sentence."""

from __future__ import annotations

import gzip
import os
import re
import struct
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from orchestrator.cli import main as cli
from shared.data.importer import load_clip
from shared.data.reading import read_all
from shared.errors import InvalidInputError
from shared.motion.body import Array
from shared.motion.io.files import motion_files, read_motion
from shared.motion.io.options import ReadOptions
from shared.motion.io.raw import LeftOutError
from tests.data.captures import FRAMES as SMPL_FRAMES
from tests.data.captures import amc, asf, asf_amc, saved, smpl
from tests.data.walks import SIX, Spelling, plain

SAME_M = 1e-3
HEAD, BODY = plain().split("Frame Time: 0.0333333\n")
ROWS = [row.split() for row in BODY.strip().splitlines()]
NO_END = re.sub(r"\t*End Site\n\t*\{\n.*\n\t*\}\n", "", plain())
CHAIN = 600


def with_rows(rows: list[list[str]], head: str = HEAD) -> str:
    return head + "Frame Time: 0.0333333\n" + "\n".join(" ".join(row) for row in rows) + "\n"


def channels_first(head: str, more: str, rows: list[list[str]]) -> str:
    """The hips' channels in another order."""
    text = head.replace(SIX.replace("CHANNELS", "CHANNELS", 1), f"CHANNELS 6 {more}", 1)
    assert text != head
    return with_rows(rows, text)


def chained() -> str:
    """A chain of bones with nothing on it hangs on the hips."""
    joints = "".join(f"JOINT tail{k} {{ OFFSET 0 0 -1 CHANNELS 3 Zrotation Xrotation Yrotation\n" for k in range(CHAIN))
    head = re.sub(r"(CHANNELS 6 [^\n]*\n)", lambda found: found.group(1) + joints + "}\n" * CHAIN, HEAD, count=1)
    return with_rows([row[:6] + ["0"] * 3 * CHAIN + row[6:] for row in ROWS], head)


def in_order(order: str) -> str:
    """Angles about the axes in another order."""
    values = np.array(ROWS, dtype=float)
    turns = Rotation.from_euler("ZXY", values[:, 3:].reshape(-1, 3), degrees=True)
    angles = turns.as_euler(order, degrees=True).reshape(len(values), -1)
    named = " ".join(f"{axis}rotation" for axis in order)
    rows = [[f"{v:.6f}" for v in row] for row in np.concatenate([values[:, :3], angles], axis=1)]
    return with_rows(rows, HEAD.replace("Zrotation Xrotation Yrotation", named))


def scaled_bones() -> str:
    head = HEAD.replace("CHANNELS 3 Z", "CHANNELS 6 Xscale Yscale Zscale Z")
    joints = range(6, len(ROWS[0]), 3)
    return with_rows([row[:6] + [v for at in joints for v in ("1", "1", "1", *row[at : at + 3])] for row in ROWS], head)


def named(pattern: str) -> str:
    return re.sub(r"(JOINT|ROOT) (\w+)", lambda found: f"{found.group(1)} {pattern.format(found.group(2))}", plain())


READ: dict[str, str | bytes] = {
    "zeros at the end": plain().encode() + b"\0" * 300,
    "the end of file of DOS": plain().encode() + b"\x1a",
    "utf-32": plain().encode("utf-32"),
    "shift-jis names": plain().replace("Spine", "\u80cc\u9aa8").encode("shift-jis"),
    "line ends doubled": plain().replace("\n", "\r\r\n"),
    "hard blanks": plain().replace("Frame Time: ", "Frame Time:\u00a0"),
    "tabs in the header": plain().replace("Frame Time: ", "Frame\tTime:\t").replace("Frames: ", "Frames:\t"),
    "decimal comma in the rate": plain().replace("0.0333333", "0,0333333"),
    "rate before the number": re.sub(r"(Frames: \d+\n)(Frame Time: .*\n)", r"\2\1", plain()),
    "rate with a unit": plain().replace("0.0333333", "0.0333333 s"),
    "powers of ten": with_rows([[f"{float(v):.6E}" for v in row] for row in ROWS]),
    "plus signs": with_rows([[f"{float(v):+.5f}" for v in row] for row in ROWS]),
    "semicolons": HEAD + "Frame Time: 0.0333333\n" + "\n".join(";".join(row) for row in ROWS),
    "no end sites": NO_END,
    "end sites that have names": plain().replace("End Site", "End LeftTip"),
    "end sites as one word": plain().replace("End Site", "EndSite"),
    "names in quotes": named('"{}"'),
    "names with a number": named("{}.001"),
    "names with a path": named("|grp|rig:{}"),
    "a joint without a name": plain().replace("JOINT Spine", "JOINT"),
    "two joints of a name": plain().replace("JOINT Spine", "JOINT Chest"),
    "a hand's name elsewhere": plain().replace("JOINT Neck", "JOINT LeftHand"),
    "the hierarchy on one line": " ".join(HEAD.split("MOTION")[0].split()) + "\nMOTION" + plain().split("MOTION")[1],
    "a long chain": chained(),
    "positions reversed": channels_first(
        HEAD, "Zposition Yposition Xposition Zrotation Xrotation Yrotation", [row[2::-1] + row[3:] for row in ROWS]
    ),
    "positions last": channels_first(
        HEAD, "Zrotation Xrotation Yrotation Xposition Yposition Zposition",
        [row[3:6] + row[:3] + row[6:] for row in ROWS],
    ),
    **{f"angles {order}": in_order(order) for order in ("XYZ", "YZX", "ZYX")},
    "channels in capitals": plain().replace("rotation", "ROTATION").replace("position", "POSITION"),
    "channels in short": plain().replace("rotation", "rot").replace("position", "pos"),
    "channels turned round": re.sub(r"([XYZ])(rotation|position)", r"\2\1", plain()).replace("rotation", "rotate"),
    "channels of scale": scaled_bones(),
    "feet": Spelling(scale=1 / 30.48).text(),
    "decimetres": Spelling(scale=0.1).text(),
    "upside down": Spelling(turn=Rotation.from_euler("z", 180, degrees=True).as_matrix()).text(),
    "z down": Spelling(turn=Rotation.from_euler("x", -90, degrees=True).as_matrix()).text(),
    "walking askew": Spelling(turn=Rotation.from_euler("y", 37, degrees=True).as_matrix()).text(),
}  # fmt: skip


@pytest.mark.parametrize("name", READ)
def test_odd_files_read_like_the_base(tmp_path: Path, walk: Array, name: str) -> None:
    text = READ[name]
    (tmp_path / "walk.bvh").write_bytes(text if isinstance(text, bytes) else text.encode())
    clip, _ = load_clip(tmp_path / "walk.bvh")
    np.testing.assert_allclose(clip.positions_w_m, walk, atol=SAME_M)


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (b"Kaydara FBX Binary  \x00\x1a\x00" + bytes(range(256)), "line 1: not BVH, but binary data"),
        (gzip.compress(plain().encode(), mtime=0), "line 1: not BVH, but binary data"),
        (b"version https://git-lfs.github.com/spec/v1\noid x\n", "line 1: not BVH: 'version https"),
        (plain().replace("Frames: 90", "Frames: -1").encode(), r"line \d+: Frames: -1 is no number of frames"),
        (plain().replace("0.0333333", "30").encode(), "Frame Time 30 s means 0.03333 frames per second"),
        (plain().replace("0.0333333", "nan").encode(), r"line \d+: Frame Time is nan"),
        (with_rows([*ROWS[:40], ["-1.#IND", *ROWS[40][1:]], *ROWS[41:]]).encode(), r"line 170: '-1.#IND' is not a"),
        (with_rows([*ROWS[:40], ["1e999", *ROWS[40][1:]], *ROWS[41:]]).encode(), r"line 170: value 1 .* is inf"),
        ((plain() + "MOTION\n" + BODY).encode(), r"line 220: 'MOTION' is not a number"),
        (
            plain().replace("CHANNELS 3 Zrotation", "CHANNELS 4 Wrotation Zrotation").encode(),
            "quaternions are not read",
        ),
        (re.sub(r"[XYZ](rotation|position)", "foo", plain()).encode(), "no channel is called as in BVH"),
        (HEAD.encode() + b"Frame Time: 0.0333333\n", "no frames after its MOTION line"),
    ],
)
def test_what_is_no_motion_is_told_in_a_sentence(tmp_path: Path, data: bytes, what: str) -> None:
    (tmp_path / "walk.bvh").write_bytes(data)
    with pytest.raises(InvalidInputError, match=what) as caught:
        read_motion(tmp_path / "walk.bvh")
    assert caught.value.message.isprintable()


# ---- two people


def two_people() -> str:
    hierarchy = HEAD.split("MOTION")[0]
    both = "".join(
        re.sub(r"(JOINT|ROOT) (\w+)", rf"\1 {who}:\2", hierarchy.replace("HIERARCHY\n", "")) for who in ("Ann", "Bob")
    )
    rows = [[*row, *row[:1], "80", *row[2:]] for row in ROWS]
    return with_rows(rows, f"HIERARCHY\n{both}MOTION{HEAD.split('MOTION')[1]}")


def test_of_two_people_the_first_is_read_and_the_other_on_request(tmp_path: Path) -> None:
    path = tmp_path / "two.bvh"
    path.write_text(two_people())
    first = read_motion(path)
    assert first.warnings == (
        "2 roots (Ann:Hips, Bob:Hips): Ann:Hips is read, the first of 2 with legs (--root says otherwise)",
    )
    second = read_motion(path, ReadOptions(root="Bob:Hips"))
    assert not second.warnings
    height = second.positions_w_m[:, 0, 2]
    np.testing.assert_allclose(height, 0.8, atol=1e-6)
    with pytest.raises(InvalidInputError, match="no root is called 'Eve'") as caught:
        read_motion(path, ReadOptions(root="Eve"))
    assert caught.value.allowed == "Ann:Hips, Bob:Hips"
    shown = CliRunner().invoke(cli.app, ["data", "import", str(path), str(tmp_path / "out"), "--root", "Bob:Hips"])
    assert shown.exit_code == 0 and "warning" not in shown.stdout


# ---- npz


def header(shape: tuple[int, ...]) -> bytes:
    """Of an npy array that is not there."""
    text = str({"descr": "<f8", "fortran_order": False, "shape": shape}).encode()
    text += b" " * (63 - (10 + len(text)) % 64) + b"\n"
    return b"\x93NUMPY\x01\0" + struct.pack("<H", len(text)) + text


def zipped(path: Path, **members: bytes) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in members.items():
            archive.writestr(f"{name}.npy", data)
    return path


def matrices() -> np.ndarray:
    return Rotation.from_rotvec(smpl()["poses"].reshape(-1, 3)).as_matrix().reshape(SMPL_FRAMES, -1, 3, 3)


@pytest.mark.parametrize(
    "changes",
    [
        {"poses": matrices()},
        {"poses": matrices().reshape(SMPL_FRAMES, -1)},
        {"trans": smpl()["trans"].T},
        {"trans": smpl()["trans"].reshape(-1)},
        {"poses": smpl()["poses"].astype(">f8")},
        {"poses": np.asfortranarray(smpl()["poses"])},
        {"mocap_framerate": np.array(b"30")},
        {"betas": np.array([{"a": 1}], dtype=object)},
    ],
    ids=["matrices", "flat matrices", "trans on its side", "flat trans", "big endian", "columns", "bytes", "objects"],
)
def test_odd_arrays_are_the_same_walk(tmp_path: Path, changes: dict[str, Any]) -> None:
    want = load_clip(saved(tmp_path / "base.npz", smpl()))[0].positions_w_m
    got = load_clip(saved(tmp_path / "a.npz", smpl(), **changes))[0].positions_w_m
    np.testing.assert_allclose(got, want, atol=SAME_M)


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"mocap_framerate": 30 + 0j}, "is no rate"),
        ({"trans": np.zeros((SMPL_FRAMES, 4))}, r"trans \(60, 4\)"),
        ({"poses": np.zeros((SMPL_FRAMES, 24, 4))}, r"poses \(60, 24, 4\)"),
    ],
)
def test_arrays_that_are_something_else_are_named(tmp_path: Path, changes: dict[str, Any], what: str) -> None:
    with pytest.raises(InvalidInputError, match=what):
        read_motion(saved(tmp_path / "a.npz", smpl(), **changes))


def test_a_folder_of_broken_archives_is_gone_through(tmp_path: Path) -> None:
    """One that is a single array once ended the whole import; one that says to be huge must not be allocated."""
    good = saved(tmp_path / "good.npz", smpl())
    with (tmp_path / "array.npz").open("wb") as stream:
        np.save(stream, smpl()["poses"])
    zipped(tmp_path / "huge.npz", poses=header((10**12, 66)), trans=header((10**12, 3)))
    zipped(tmp_path / "none.npz", poses=b"no arr", trans=b"")
    np.savez_compressed(tmp_path / "packed.npz", **smpl())
    data = bytearray((tmp_path / "packed.npz").read_bytes())
    data[300:340] = bytes(40)
    (tmp_path / "packed.npz").write_bytes(data)
    np.savez(tmp_path / "half.npz", positions_w_m=np.zeros((60, 22, 3)), fps=30.0)
    np.savez(tmp_path / "still.npz", poses=np.zeros((0, 66)), trans=np.zeros((0, 3)))
    outcomes = {outcome.label: outcome for outcome in read_all(motion_files(tmp_path), tmp_path)}
    assert [label for label, outcome in outcomes.items() if outcome.loaded is not None] == [good.name]
    assert outcomes["half.npz"].left_out.startswith("no motion in it")
    assert outcomes["still.npz"].left_out == "0 frames are too few"
    for name in ("array.npz", "huge.npz", "none.npz", "packed.npz"):
        assert outcomes[name].error.startswith("not a readable npz"), outcomes[name]


def test_no_frames_are_left_out_for_a_reason(tmp_path: Path) -> None:
    with pytest.raises(LeftOutError, match="0 frames"):
        read_motion(saved(tmp_path / "a.npz", smpl(), poses=np.zeros((0, 156)), trans=np.zeros((0, 3))))


# ---- ASF + AMC


def test_bones_that_only_one_of_both_files_has_are_said(tmp_path: Path) -> None:
    motion = re.sub(r"(?m)^lfemur.*$", "hat 1 2 3", amc())
    raw = read_motion(asf_amc(tmp_path, asf(), motion), ReadOptions(fps=30.0))
    assert "01.asf has no hat: passed over" in raw.warnings
    assert "no values for lfemur of 01.asf: held as in its zero pose" in raw.warnings


# ---- names and paths


def test_names_of_any_bytes_and_links_to_nothing_end_in_a_row_each(tmp_path: Path) -> None:
    source = tmp_path / "in"
    source.mkdir()
    for name in (b"w\xe4lk.bvh", b"line\nbreak.bvh", b"-rf.bvh", b"walk.bvh.bvh"):
        Path(os.fsdecode(bytes(source) + b"/" + name)).write_text(plain())
    (source / "gone.bvh").symlink_to(tmp_path / "nowhere.bvh")
    (source / "folder.bvh").mkdir()
    shown = CliRunner().invoke(cli.app, ["data", "import", str(source), str(tmp_path / "out")])
    lines = shown.stdout.splitlines()
    assert shown.exit_code == 1
    assert "error: gone.bvh: a link to a file that is not there" in lines
    assert lines[-1] == "4 imported, 1 could not be read" and len(lines) == 6
    assert len(list((tmp_path / "out").glob("*.npz"))) == 4


def test_a_type_that_is_not_read_says_which_are(tmp_path: Path) -> None:
    (tmp_path / "walk.fbx").write_text("x")
    with pytest.raises(InvalidInputError, match=r"not one of the types that are read: \.bvh, \.amc, \.npz"):
        read_motion(tmp_path / "walk.fbx")
