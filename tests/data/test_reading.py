"""What a BVH file says and what is made of it: joint maps, rates, axes, roots; what cannot be read names its line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from shared.data.importer import load_clip
from shared.errors import InvalidInputError
from shared.motion.body import Array
from shared.motion.io.files import read_motion
from shared.motion.io.options import ReadOptions, read_joint_map
from tests.data.exporters import LIMBS
from tests.data.walks import JOINTS, Spelling, plain, with_camera

SAME_M = 1e-3


def test_unknown_names_are_listed_and_a_map_helps(tmp_path: Path, walk: Array) -> None:
    numbers = {name: f"Bone_{i}" for i, (name, _, _) in enumerate(JOINTS)}
    path = tmp_path / "walk.bvh"
    path.write_text(Spelling(names=numbers | {"LeftUpLeg": "LeftUpLeg"}).text())
    with pytest.raises(InvalidInputError, match=r"cannot find left_knee.*found: left_hip is LeftUpLeg.*Bone_14"):
        load_clip(path)
    ours = {
        f"{side.lower()}_{part}": f"{side}{theirs}"
        for side in ("Left", "Right")
        for part, theirs in zip(
            ("collar", "shoulder", "elbow", "wrist", "hip", "knee", "ankle", "foot"), LIMBS, strict=True
        )
    } | {"neck": "Neck", "head": "Head"}
    path.write_text(Spelling(names=numbers).text())
    (tmp_path / "map.json").write_text(json.dumps({mark: numbers[name] for mark, name in ours.items()}))
    clip, _ = load_clip(path, options=ReadOptions(joints=read_joint_map(tmp_path / "map.json")))
    np.testing.assert_allclose(clip.positions_w_m, walk, atol=SAME_M)


@pytest.mark.parametrize(
    ("joints", "what"),
    [
        ({"left_thigh": "LeftUpLeg"}, "no joint of ours"),
        ({"LeftUpLeg": "left_hip"}, "from our names to the file's"),
        ({"left_hip": "Schenkel"}, "which the file does not have"),
    ],
)
def test_a_wrong_map_is_refused(tmp_path: Path, joints: dict[str, str], what: str) -> None:
    (tmp_path / "walk.bvh").write_text(plain())
    with pytest.raises(InvalidInputError, match=what):
        load_clip(tmp_path / "walk.bvh", options=ReadOptions(joints=joints))


@pytest.mark.parametrize("text", ["[1, 2]", "{", '{"left_hip": 3}'])
def test_a_map_that_is_none_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "map.json").write_text(text)
    with pytest.raises(InvalidInputError, match="joint map"):
        read_joint_map(tmp_path / "map.json")


def _cut(row: int, keep: slice) -> str:
    lines = plain().splitlines()
    at = next(i for i, line in enumerate(lines) if line.startswith("Frame Time")) + row
    lines[at] = " ".join(lines[at].split()[keep])
    return "\n".join(lines)


def _line_of_row(row: int) -> int:
    return next(i for i, line in enumerate(plain().splitlines(), 1) if line.startswith("Frame Time")) + row


def _with_value(row: int, value: str) -> str:
    lines = plain().splitlines()
    words = lines[_line_of_row(row) - 1].split()
    words[7] = value
    lines[_line_of_row(row) - 1] = " ".join(words)
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("text", "what"),
    [
        (_cut(41, slice(0, -1)), rf"line {_line_of_row(41)}: 65 values where the channels make 66"),
        (_cut(41, slice(0, 70)).replace("\nMOTION", "\nMOTION") + " 1.0", "67 values where"),
        (_cut(90, slice(0, 30)), rf"line {_line_of_row(90)}: 30 values .* cut off"),
        (_with_value(12, "nan"), rf"line {_line_of_row(12)}: value 8 \(.*\) is nan"),
        (_with_value(12, "1e999"), rf"line {_line_of_row(12)}: value 8 .* is inf"),
        (_with_value(12, "abc"), rf"line {_line_of_row(12)}: 'abc' is not a number"),
        (plain().replace("OFFSET 0.00000 12.00000", "OFFSET 0.00000 x"), r"line 8: OFFSET"),
        (plain().replace("CHANNELS 3 Z", "CHANNELS 4 Z", 1), r"line 9: CHANNELS says 4"),
        (plain().replace("\t{\n", "\tsurprise\n\t{\n", 1), r"line \d+: not BVH: 'surprise'"),
        (plain().replace("Frames: 90", "Frames: many"), "Frames 'many' is not a number"),
        (plain().split("MOTION")[0], "without a MOTION section"),
        (plain().split("Frame Time")[0] + "Frame Time: 0.0333333\n", "no frames"),
        (plain().replace("}\nMOTION", "MOTION"), "MOTION before the '}' of Hips"),
        (Spelling(frame_time="33.333").text(), "Frame Time 33.333 s means 0.03"),
        (Spelling(frame_time="0.0000333").text(), "means 3.003e"),
        (Spelling(frame_time="0").text(), "Frame Time is 0"),
        (Spelling(frame_time="nan").text(), "Frame Time is nan"),
        (Spelling(frame_time="-0.033").text(), "which no recording has"),
        ("", "empty"),
        ("\n \n", "empty"),
        ("HIERARCHY\n", "without a MOTION"),
    ],
)
def test_what_cannot_be_read_is_named(tmp_path: Path, text: str, what: str) -> None:
    (tmp_path / "walk.bvh").write_text(text)
    with pytest.raises(InvalidInputError, match=what) as caught:
        load_clip(tmp_path / "walk.bvh")
    assert caught.value.message.startswith("walk.bvh: ")


def test_a_given_rate_goes_before_the_file_and_is_said(tmp_path: Path, walk: Array) -> None:
    (tmp_path / "walk.bvh").write_text(Spelling(frame_time="33.333").text())
    raw = read_motion(tmp_path / "walk.bvh", ReadOptions(fps=30.0))
    assert raw.fps == 30.0
    assert any("as asked" in warning for warning in raw.warnings)
    clip, _ = load_clip(tmp_path / "walk.bvh", options=ReadOptions(fps=30.0))
    np.testing.assert_allclose(clip.positions_w_m, walk, atol=SAME_M)


def test_a_given_axis_and_unit_go_before_what_is_seen(tmp_path: Path) -> None:
    (tmp_path / "walk.bvh").write_text(plain())
    raw = read_motion(tmp_path / "walk.bvh", ReadOptions(up="z", unit_m=0.02))
    assert raw.up == "z" and raw.unit_m == 0.02
    at = {name: raw.positions_w_m[0, i] for i, name in enumerate(raw.names)}
    assert at["Hips"][1] == pytest.approx(0.02 * 91.5, abs=1e-6)
    assert any("legs of 1.62 m" in warning for warning in raw.warnings)


@pytest.mark.parametrize(("said", "read"), [(80, 80), (95, 90), (0, 90)])
def test_a_wrong_number_of_frames_is_said(tmp_path: Path, said: int, read: int) -> None:
    (tmp_path / "walk.bvh").write_text(plain().replace("Frames: 90", f"Frames: {said}"))
    raw = read_motion(tmp_path / "walk.bvh")
    assert len(raw) == read
    assert raw.warnings and f"Frames says {said}, 90 rows follow" in raw.warnings[0]


def test_several_roots_are_said_and_the_one_with_legs_is_read(tmp_path: Path) -> None:
    (tmp_path / "walk.bvh").write_text(with_camera(plain(), first=True))
    (warning,) = read_motion(tmp_path / "walk.bvh").warnings
    assert warning == "2 roots (Camera, Hips): Hips is read, the one with legs"


def test_the_plain_file_needs_no_warning(tmp_path: Path) -> None:
    (tmp_path / "walk.bvh").write_text(plain())
    assert read_motion(tmp_path / "walk.bvh").warnings == ()
