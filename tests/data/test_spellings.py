"""The same walk in the spellings of many exporters comes in as the same walk."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from shared.data.importer import load_clip
from shared.motion.body import Array
from shared.motion.io.files import read_motion
from shared.motion.skeleton import CANONICAL
from tests.data.exporters import EXPORTERS
from tests.data.walks import (
    FRAMES,
    JOINTS,
    SIX,
    WALKED_M,
    X_UP,
    Z_UP,
    Spelling,
    along_bones,
    comma,
    hips,
    lines_with,
    local_rotations,
    plain,
    with_camera,
)

SAME_M = 1e-3


def wrapped(text: str) -> str:
    """Each frame on two lines."""
    head, rows = text.split("Frame Time: 0.0333333\n")
    half = [row.split() for row in rows.strip().splitlines()]
    return head + "Frame Time: 0.0333333\n" + "\n".join(" ".join(r[:20]) + "\n" + " ".join(r[20:]) for r in half)


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
    "axes along the bones": Spelling(axes=along_bones()),
    "axes of any kind": Spelling(
        axes={
            name: Rotation.from_rotvec(3.0 * np.sin([i, 2 * i, 5 * i])).as_matrix()
            for i, (name, _, _) in enumerate(JOINTS)
        }
    ),
    "metres": Spelling(scale=0.01),
    "millimetres": Spelling(scale=10.0),
    "inches": Spelling(scale=1 / 2.54),
}


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


@pytest.mark.parametrize("offsets", [True, False])
def test_a_walk_of_positions_only_is_the_same_walk(tmp_path: Path, walk: Array, offsets: bool) -> None:
    (tmp_path / "walk.bvh").write_text(only_moving(offsets))
    (warning,) = read_motion(tmp_path / "walk.bvh").warnings
    assert "fitted to the positions" in warning
    clip, _ = load_clip(tmp_path / "walk.bvh")
    np.testing.assert_allclose(clip.positions_w_m, walk, atol=SAME_M)


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
