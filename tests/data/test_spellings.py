"""The same walk in the spellings of many exporters comes in as the same walk; what cannot be read names its line."""

from __future__ import annotations

import functools
import json
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from shared.data.importer import load_clip
from shared.errors import InvalidInputError
from shared.motion.body import Array
from shared.motion.io.files import read_motion
from shared.motion.io.options import ReadOptions, read_joint_map
from shared.motion.skeleton import CANONICAL
from tests.data.walks import FRAMES, JOINTS, WALKED_M, X_UP, Z_UP, Spelling, hips, local_rotations, plain

SAME_M = 1e-3
SIX = "CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation"


@functools.cache
def base(folder: Path) -> Array:
    (folder / "base.bvh").write_text(plain())
    return load_clip(folder / "base.bvh")[0].positions_w_m


@pytest.fixture(scope="session")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Array:
    """The base as a clip."""
    return base(tmp_path_factory.mktemp("base"))


def lines_with(at: str, new: str, text: str | None = None) -> str:
    """The plain file with a pattern replaced once."""
    out, count = re.subn(at, new, plain() if text is None else text, count=1, flags=re.MULTILINE)
    assert count == 1
    return out


def comma(text: str) -> str:
    return re.sub(r"(\d)\.(\d)", r"\1,\2", text)


def wrapped(text: str) -> str:
    """Each frame on two lines."""
    head, rows = text.split("Frame Time: 0.0333333\n")
    half = [row.split() for row in rows.strip().splitlines()]
    return head + "Frame Time: 0.0333333\n" + "\n".join(" ".join(r[:20]) + "\n" + " ".join(r[20:]) for r in half)


CAMERA = "ROOT Camera\n{\n\tOFFSET 0 0 0\n\t" + SIX + "\n\tEnd Site\n\t{\n\t\tOFFSET 0 0 10\n\t}\n}\n"


def with_camera(text: str, first: bool = False) -> str:
    head, rows = text.split("Frame Time: 0.0333333\n")
    head = (
        head.replace("HIERARCHY\n", "HIERARCHY\n" + CAMERA) if first else head.replace("MOTION\n", CAMERA + "MOTION\n")
    )
    values = "700 150 -300 0 20 0"
    joined = [f"{values} {row}" if first else f"{row} {values}" for row in rows.strip().splitlines()]
    return head + "Frame Time: 0.0333333\n" + "\n".join(joined) + "\n"


QUARTER = Rotation.from_euler("x", -90, degrees=True).as_matrix()

TEXTS: dict[str, bytes] = {
    "utf-8 with mark": plain().encode("utf-8-sig"),
    "utf-16": plain().encode("utf-16"),
    "utf-16 without mark": plain().encode("utf-16-le"),
    "utf-16 big endian": b"\xfe\xff" + plain().encode("utf-16-be"),
    "latin-1": plain().replace("Spine", "Wirbels\xe4ule").encode("latin-1"),
    "crlf": plain().replace("\n", "\r\n").encode(),
    "old mac": plain().replace("\n", "\r").encode(),
    "lower case": re.sub(
        "HIERARCHY|ROOT|JOINT|OFFSET|CHANNELS|MOTION|End Site|Frames|Frame Time", lambda m: m.group().lower(), plain()
    ).encode(),
    "brace on the line of the name": re.sub(r"\n\t*\{", " {", plain()).encode(),
    "blank after motion": lines_with("^MOTION$", "MOTION\n").encode(),
    "blank lines": plain().replace("\n", "\n\n").encode(),
    "blanks at the end": (plain() + "\n \n\t\n").encode(),
    "tabs": (
        plain().split("Frame Time")[0] + "Frame Time" + plain().split("Frame Time")[1].replace(" ", "\t")
    ).encode(),
    "no colon": plain().replace("Frames:", "Frames").replace("Frame Time:", "Frame Time").encode(),
    "no blank after the colon": plain().replace("Frames: ", "Frames:").replace("Time: ", "Time:").encode(),
    "decimal comma": comma(plain()).encode(),
    "commas between": re.sub(r"(?<=\d) (?=-?\d)", ", ", plain()).encode(),
    "wrapped rows": wrapped(plain()).encode(),
    "a comment": ("# made by hand\n" + plain()).encode(),
    "camera after": with_camera(plain()).encode(),
    "camera before": with_camera(plain(), first=True).encode(),
}
SPELLINGS: dict[str, Spelling] = {
    "position channels": Spelling(moving=True),
    "bones only in the channels": Spelling(without_offsets=True),
    "channels added to offsets": Spelling(added=True),
    "root above the hips": Spelling(above=(SIX, "0 0 0 0 0 0", np.eye(3))),
    "root without channels": Spelling(above=("CHANNELS 0", "", np.eye(3))),
    "root above and bones in the channels": Spelling(above=(SIX, "0 0 0 0 0 0", np.eye(3)), without_offsets=True),
    "z up": Spelling(turn=Z_UP),
    "x up": Spelling(turn=X_UP),
    "z up by the root's rotation": Spelling(turn=Z_UP, rest=np.eye(3)),
    "z up under a turned armature": Spelling(rest=Z_UP, above=(SIX, "0 0 0 0 -90 0", QUARTER)),
    "metres": Spelling(scale=0.01),
    "millimetres": Spelling(scale=10.0),
    "inches": Spelling(scale=1 / 2.54),
}

LIMBS = ("Shoulder", "Arm", "ForeArm", "Hand", "UpLeg", "Leg", "Foot", "ToeBase")


def renamed(middle: dict[str, str], limb: str, parts: tuple[str, ...], sides: tuple[str, str]) -> Spelling:
    """Names from a pattern with {s} for the side and {p} for the part, the parts in the order of LIMBS."""
    names = dict(middle)
    for word, side in zip(("Left", "Right"), sides, strict=True):
        names |= {f"{word}{old}": limb.format(s=side, p=new) for old, new in zip(LIMBS, parts, strict=True)}
    return Spelling(names=names)


ABBREVIATED = ("Clavicle", "UpperArm", "Forearm", "Hand", "Thigh", "Calf", "Foot", "Toe0")
VRM = ("Shoulder", "UpperArm", "LowerArm", "Hand", "UpperLeg", "LowerLeg", "Foot", "ToeBase")
JOINT_WORDS = ("Collar", "Shoulder", "Elbow", "Wrist", "Hip", "Knee", "Ankle", "Foot")


def middle(pattern: str) -> dict[str, str]:
    return {name: pattern.format(p=name) for name in ("Hips", "Spine", "Chest", "Neck", "Head")}


EXPORTERS: dict[str, tuple[Spelling, str]] = {
    "biped": (renamed(middle("Bip001 {p}") | {"Hips": "Bip001"}, "Bip001 {s} {p}", ABBREVIATED, ("L", "R")), "3ds Max"),
    "biped 01": (renamed(middle("Bip01_{p}"), "Bip01_{s}_{p}", ABBREVIATED, ("L", "R")), "3ds Max"),
    "biped without blanks": (renamed(middle("Bip001{p}"), "Bip001{s}{p}", ABBREVIATED, ("L", "R")), "3ds Max"),
    "vroid": (renamed(middle("J_Bip_C_{p}"), "J_Bip_{s}_{p}", VRM, ("L", "R")), "VRoid"),
    "daz 3": (
        renamed(
            {"Hips": "hip", "Spine": "abdomenLower", "Chest": "chestLower", "Neck": "neckLower", "Head": "head"},
            "{s}{p}", ("Collar", "ShldrBend", "ForearmBend", "Hand", "ThighBend", "Shin", "Foot", "Toe"), ("l", "r"),
        ),
        "Daz",
    ),
    "daz 9": (
        renamed(middle("{p}"), "{s}_{p}",
                ("shoulder", "upperarm", "forearm", "hand", "thigh", "shin", "foot", "toes"), ("l", "r")),
        "Daz",
    ),
    "poser": (
        renamed({"Hips": "hip"}, "{s}{p}",
                ("Collar", "Shldr", "ForeArm", "Hand", "Thigh", "Shin", "Foot", "Toe"), ("l", "r")),
        "Daz",
    ),
    "mixamo": (Spelling(names=lambda n: f"mixamorig:{n}"), "Mixamo"),
    "mixamo 1": (Spelling(names=lambda n: f"mixamorig1:{n}"), "Mixamo"),
    "mixamo 12 underscore": (Spelling(names=lambda n: f"mixamorig12_{n}"), "Mixamo"),
    "mixamo glued": (Spelling(names=lambda n: f"mixamorig{n}"), "Mixamo"),
    "rokoko": (
        renamed({}, "{s}{p}", ("Shoulder", "Arm", "ForeArm", "Hand", "Thigh", "Shin", "Foot", "Toe"),
                ("Left", "Right")),
        "Rokoko",
    ),
    "unreal": (
        renamed({"Hips": "pelvis", "Spine": "spine_01", "Chest": "spine_03", "Neck": "neck_01", "Head": "head"},
                "{p}_{s}", ("clavicle", "upperarm", "lowerarm", "hand", "thigh", "calf", "foot", "ball"), ("l", "r")),
        "Unreal",
    ),
    "smpl-h": (renamed(middle("{p}") | {"Hips": "Pelvis"}, "{s}_{p}", JOINT_WORDS, ("L", "R")), "SMPL"),
    "smpl addon": (renamed(middle("m_avg_{p}"), "m_avg_{s}_{p}", JOINT_WORDS, ("L", "R")), "SMPL"),
    "smpl-x": (
        renamed(middle("{p}"), "{s}_{p}", tuple(w.lower() for w in JOINT_WORDS), ("left", "right")),
        "SMPL",
    ),
    "cmu names in a bvh": (
        renamed({"Hips": "root", "Chest": "thorax", "Neck": "lowerneck", "Head": "head"}, "{s}{p}",
                ("clavicle", "humerus", "radius", "wrist", "femur", "tibia", "foot", "toes"), ("l", "r")),
        "Acclaim",
    ),
    "human ik with a character": (Spelling(names=lambda n: f"Character1_{n}"), "HumanIK"),
    "xsens": (
        renamed({"Hips": "Pelvis", "Spine": "L3", "Chest": "T8"}, "{s}{p}",
                ("Shoulder", "UpperArm", "ForeArm", "Hand", "UpperLeg", "LowerLeg", "Foot", "Toe"), ("Left", "Right")),
        "Xsens",
    ),
    "perception neuron": (Spelling(names=lambda n: f"Robot_{n}"), "HumanIK"),
    "optitrack": (
        renamed({"Hips": "Hip", "Spine": "Ab"}, "{s}{p}",
                ("Shoulder", "UArm", "FArm", "Hand", "Thigh", "Shin", "Foot", "Toe"), ("L", "R")),
        "OptiTrack",
    ),
    "auto-rig pro": (
        renamed({"Hips": "root.x", "Neck": "neck.x", "Head": "head.x"}, "{p}.{s}",
                ("shoulder", "arm_stretch", "forearm_stretch", "hand", "thigh_stretch", "leg_stretch", "foot",
                 "toes_01"), ("l", "r")),
        "other",
    ),
    "mocopi": (
        renamed({"Hips": "root", "Spine": "torso_1", "Chest": "torso_7", "Neck": "neck_1", "Head": "head"}, "{s}_{p}",
                ("shoulder", "up_arm", "low_arm", "hand", "up_leg", "low_leg", "foot", "toes"), ("l", "r")),
        "other",
    ),
    "second life": (
        renamed(middle("m{p}") | {"Hips": "mPelvis"}, "m{p}{s}",
                ("Collar", "Shoulder", "Elbow", "Wrist", "Hip", "Knee", "Ankle", "Foot"), ("Left", "Right")),
        "other",
    ),
    "source": (
        renamed(middle("ValveBiped.Bip01_{p}"), "ValveBiped.Bip01_{s}_{p}", ABBREVIATED, ("L", "R")),
        "Source",
    ),
    "makehuman": (
        renamed({"Hips": "root", "Neck": "neck01"}, "{p}.{s}",
                ("clavicle", "upperarm01", "lowerarm01", "wrist", "upperleg01", "lowerleg01", "foot", "toe1-1"),
                ("L", "R")),
        "other",
    ),
    "b prefix": (
        renamed(middle("b_{p}") | {"Hips": "b_root"}, "b_{s}_{p}",
                ("shoulder", "arm", "forearm", "wrist", "upleg", "leg", "foot", "ball"), ("l", "r")),
        "other",
    ),
    "kinect": (
        renamed({"Hips": "SpineBase"}, "{p}{s}",
                ("Clavicle", "Shoulder", "Elbow", "Wrist", "Hip", "Knee", "Ankle", "Foot"), ("Left", "Right")),
        "other",
    ),
    "upper and lower": (
        renamed({}, "{s}{p}", ("Collar", "ArmUpper", "ArmLower", "Hand", "LegUpper", "LegLower", "Foot", "Toe"),
                ("Left", "Right")),
        "other",
    ),
    "rigify": (
        renamed({}, "DEF-{p}.{s}", ("shoulder", "upper_arm", "forearm", "hand", "thigh", "shin", "foot", "toe"),
                ("L", "R")),
        "Rigify",
    ),
    "jnt": (Spelling(names=lambda n: f"{n}_JNT"), "HumanIK"),
    "a studio's own prefix": (Spelling(names=lambda n: f"Dancer07_{n}"), "HumanIK"),
    "hip knee ankle": (
        renamed({}, "{s}{p}", ("Collar", "Shoulder", "Elbow", "Wrist", "Hip", "Knee", "Ankle", "Toe"),
                ("Left", "Right")),
        "hip-knee-ankle",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", TEXTS)
def test_texts_read_like_the_base(tmp_path: Path, walk: Array, name: str) -> None:
    (tmp_path / "walk.bvh").write_bytes(TEXTS[name])
    clip, _ = load_clip(tmp_path / "walk.bvh")
    np.testing.assert_allclose(clip.positions_w_m, walk, atol=SAME_M)


@pytest.mark.parametrize("name", SPELLINGS)
def test_spellings_read_like_the_base(tmp_path: Path, walk: Array, name: str) -> None:
    (tmp_path / "walk.bvh").write_text(SPELLINGS[name].text())
    clip, _ = load_clip(tmp_path / "walk.bvh")
    np.testing.assert_allclose(clip.positions_w_m, walk, atol=SAME_M)


@pytest.mark.parametrize("name", EXPORTERS)
def test_names_of_the_usual_exporters_are_known(tmp_path: Path, walk: Array, name: str) -> None:
    spelling, family = EXPORTERS[name]
    (tmp_path / "walk.bvh").write_text(spelling.text())
    raw = read_motion(tmp_path / "walk.bvh")
    assert raw.family.startswith(family)
    assert set(raw.landmarks()) >= {
        f"{s}_{p}" for s in ("left", "right") for p in ("hip", "shoulder", "elbow", "wrist")
    }
    clip, _ = load_clip(tmp_path / "walk.bvh")
    np.testing.assert_allclose(clip.positions_w_m, walk, atol=SAME_M)


def only_moving(offsets: bool) -> str:
    """The walk as positions of joints in their parents' place, without a rotation."""
    parents = {name: parent for name, parent, _ in JOINTS}
    bones = {name: np.array(offset, dtype=float) for name, _, offset in JOINTS}
    turns: dict[str, Array] = {}
    steps: dict[str, Array] = {}
    for name, parent, _ in JOINTS:
        above = turns.get(parent, np.broadcast_to(np.eye(3), (FRAMES, 3, 3)))
        steps[name] = above @ bones[name] if parent else hips()
        turns[name] = above @ local_rotations().get(name, np.eye(3))
    text = Spelling(moving=offsets, without_offsets=not offsets).text()
    text = re.sub(r"CHANNELS 6 (.position .position .position).*", r"CHANNELS 3 \1", text)
    order = re.findall(r"(?:ROOT|JOINT) (\w+)", text)
    assert set(order) == set(parents)
    rows = np.concatenate([steps[name] for name in order], axis=1)
    head = text.split("Frame Time")[0] + "Frame Time: 0.0333333\n"
    return head + "\n".join(" ".join(f"{v:.5f}" for v in row) for row in rows) + "\n"


@pytest.mark.parametrize(("offsets", "within_m"), [(True, SAME_M), (False, 0.06)])
def test_a_walk_of_positions_only_is_the_same_walk(tmp_path: Path, walk: Array, offsets: bool, within_m: float) -> None:
    """Without offsets nothing says how the feet and the trunk are held in a neutral pose: it is the first frame's."""
    (tmp_path / "walk.bvh").write_text(only_moving(offsets))
    (warning,) = read_motion(tmp_path / "walk.bvh").warnings
    assert "fitted to the positions" in warning
    clip, _ = load_clip(tmp_path / "walk.bvh")
    np.testing.assert_allclose(clip.positions_w_m, walk, atol=within_m)


def test_the_base_walks_as_far_as_it_should(walk: Array) -> None:
    # Legs of 81 cm become legs of 85.9 cm, and the way with them.
    assert walk[-1, 0, 0] - walk[0, 0, 0] == pytest.approx(WALKED_M * 0.8593 / 0.81, rel=0.01)
    assert len(walk) == FRAMES


def test_a_skeleton_without_toes_whose_zero_pose_is_no_stand(tmp_path: Path) -> None:
    """The zero pose is laid on its back, so that upright frames calibrate; nothing shows which way a foot points."""
    turn = Rotation.from_euler("x", 35, degrees=True).as_matrix()
    text = Spelling(turn=np.eye(3), rest=turn).text()
    names = re.findall(r"(?:ROOT|JOINT) (\w+)", text)
    toes = [3 + 3 * names.index(f"{side}ToeBase") + k for side in ("Left", "Right") for k in range(3)]
    head, rows = text.split("Frame Time: 0.0333333\n")
    for side in ("Left", "Right"):
        head, count = re.subn(rf"\t*JOINT {side}ToeBase\n(\t*)\{{.*?\n\1\}}\n", "", head, flags=re.DOTALL)
        assert count == 1
    kept = [" ".join(w for k, w in enumerate(row.split()) if k not in toes) for row in rows.strip().splitlines()]
    (tmp_path / "walk.bvh").write_text(head + "Frame Time: 0.0333333\n" + "\n".join(kept) + "\n")
    raw = read_motion(tmp_path / "walk.bvh")
    assert "left_toe" not in raw.landmarks() and raw.up == "y"
    clip, _ = load_clip(tmp_path / "walk.bvh")
    foot = clip.positions_w_m[:, CANONICAL.index("left_foot")] - clip.positions_w_m[:, CANONICAL.index("left_ankle")]
    assert foot[:, 0].min() > 0.05


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


@pytest.mark.parametrize("heading", [0, 90, 200])
def test_a_walk_whose_root_begins_at_the_origin_stands(tmp_path: Path, walk: Array, heading: float) -> None:
    """The root's rotation takes the Y-up zero pose to a Z-up world; no height says where the floor is."""
    turn = Rotation.from_euler("z", heading, degrees=True).as_matrix() @ Z_UP
    lines = Spelling(turn=turn, rest=np.eye(3)).text().splitlines()
    at = next(i for i, line in enumerate(lines) if line.startswith("Frame Time")) + 1
    for i in range(at, len(lines)):
        x, y, z, *rest = lines[i].split()
        lines[i] = " ".join([x, y, f"{float(z) - 91.5:.5f}", *rest])
    (tmp_path / "walk.bvh").write_text("\n".join(lines))
    clip, _ = load_clip(tmp_path / "walk.bvh")
    np.testing.assert_allclose(clip.positions_w_m, walk, atol=SAME_M)


def test_a_body_that_lies_does_not_turn_the_world(tmp_path: Path) -> None:
    """The root's rotation lays a body on its back throughout; the zero pose says which way is up."""
    spelling = Spelling(turn=Rotation.from_euler("x", 90, degrees=True).as_matrix(), rest=np.eye(3))
    lines = spelling.text().splitlines()
    at = next(i for i, line in enumerate(lines) if line.startswith("Frame Time")) + 1
    for i in range(at, len(lines)):
        words = lines[i].split()
        still = ["0"] * (len(words) - 6)
        # 15 cm above the floor of Y = 0, nothing else moves
        lines[i] = " ".join([words[0], "15.0", f"{150 + 0.01 * i:.3f}", *words[3:6], *still])
    (tmp_path / "lying.bvh").write_text("\n".join(lines))
    raw = read_motion(tmp_path / "lying.bvh")
    assert raw.up == "y"
    assert any("zero pose stands along Y" in warning for warning in raw.warnings)
    assert np.ptp(raw.positions_w_m[0, :, 2]) < 0.7
