"""`data build` on a folder of one's own: labels by folder, name, text or motion; errors by file; nothing is deleted."""

from __future__ import annotations

import json
import tarfile
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from orchestrator.cli import main as cli
from shared.data.build import build
from shared.data.corpus import Corpus
from shared.data.label import Label
from shared.data.own import behaviour_named, own_pieces, own_takes, seen
from shared.data.pieces import Piece, Report
from shared.data.sources import list_takes
from shared.data.texts import BEHAVIOURS
from shared.motion.body import Array, J
from shared.motion.io.options import ReadOptions
from tests.data.samples import stand, stepping
from tests.data.walks import Spelling, plain


def command(*arguments: object) -> Result:
    return CliRunner().invoke(cli.app, ["data", "build", *map(str, arguments)])


@pytest.mark.parametrize(
    ("name", "behaviour"),
    [
        ("walk", "walk"), ("walks", "walk"), ("Walking_03", "walk"), ("running", "run"), ("waving", "wave"),
        ("getting_up", "get_up"), ("getUp", "get_up"), ("lie_down", "lie_down"), ("kick-left", "kick"),
        ("punches", "punch"), ("session1", ""), ("walk_and_run", ""), ("other", ""), ("boardwalk", ""), ("01", ""),
    ],
)  # fmt: skip
def test_names_that_say_a_behaviour(name: str, behaviour: str) -> None:
    assert behaviour_named(name) == behaviour


def test_every_behaviour_is_named_by_itself() -> None:
    assert [b for b in BEHAVIOURS if behaviour_named(b) != b] == ["other"]


def test_takes_of_a_plain_folder(tmp_path: Path) -> None:
    mine = tmp_path / "mine"
    for name in ("a.bvh", "kicks/a.bvh", "kicks/deep/b.bvh", "day1/wave_02.bvh", "day1/c.bvh", "day1/c.BVH"):
        (mine / name).parent.mkdir(parents=True, exist_ok=True)
        (mine / name).write_text(plain())
    (mine / "day1" / "c.txt").write_text("A person strolls.\nshe walks on\n")
    takes = {t.name: t for t in own_takes(mine, ReadOptions())}
    assert list_takes(mine) == []
    assert set(takes) == {
        "mine/a", "kicks/a", "kicks/deep/b", "day1/wave_02", "day1/c_bvh", "day1/c_BVH",
    }  # fmt: skip
    assert [takes[n].behaviour for n in ("kicks/a", "kicks/deep/b", "day1/wave_02")] == ["kick", "kick", "wave"]
    assert [t.by_motion for t in takes.values()].count(True) == 3
    assert takes["day1/c_bvh"].texts == ("a person strolls", "she walks on")
    assert len({t.skeleton_key for t in takes.values()}) == len(takes)


@pytest.mark.parametrize("behaviour", BEHAVIOURS)
def test_a_folder_of_any_behaviour_gives_clips_with_sentences(tmp_path: Path, behaviour: str) -> None:
    (tmp_path / behaviour).mkdir()
    (tmp_path / behaviour / "a.bvh").write_text(plain())
    (tmp_path / behaviour / "a.txt").write_text("")
    report = Report()
    pieces = own_pieces(own_takes(tmp_path / behaviour, ReadOptions()), report, lambda what, share: None)
    assert report.errors == [] and report.lines[0].startswith(f"{behaviour}/a  30 fps")
    assert all(len(piece.texts) >= 2 and piece.label.behaviour in BEHAVIOURS for piece in pieces)
    assert pieces or report.lines[1].startswith(f"warning: {behaviour}/a: left out: ")


def test_an_unlabelled_folder_is_built_by_what_the_motion_shows(tmp_path: Path) -> None:
    mine = tmp_path / "session1"
    mine.mkdir()
    (mine / "a.bvh").write_text(plain())
    (mine / "b.bvh").write_text(Spelling(scale=0.01, names=lambda n: f"mixamorig:{n}").text())
    (mine / "a.txt").write_text("someone crosses the room")
    shown = command(mine, tmp_path / "corpus", "--json", tmp_path / "r.json")
    assert shown.exit_code == 0, shown.output
    lines = shown.stdout.splitlines()
    assert lines[0].startswith("session1/a  30 fps  3.00 s  up Y  unit cm  skeleton HumanIK  travelled 3.4")
    assert lines[0].endswith("-> 1 clips: walk")
    assert "unit m  skeleton Mixamo" in lines[1]
    corpus = Corpus.load(tmp_path / "corpus")
    recorded = {c.take: c for c in corpus.clips if not c.made and not c.mirrored}
    assert {c.behaviour for c in recorded.values()} == {"walk"}
    assert recorded["session1/a"].texts[0] == "someone crosses the room"
    result = json.loads((tmp_path / "r.json").read_text())
    assert result["errors"] == []
    assert [(f["take"], f["fps"], f["up"], f["unit_m"]) for f in result["files"]] == [
        ("session1/a", 30.0, "y", 0.01), ("session1/b", 30.0, "y", 1.0),
    ]  # fmt: skip


def test_bad_files_are_reported_and_the_others_built(tmp_path: Path) -> None:
    mine = tmp_path / "walks"
    mine.mkdir()
    (mine / "a.bvh").write_text(plain())
    (mine / "b_empty.bvh").write_text("")
    (mine / "c_nan.bvh").write_text(plain().replace("0.00000 91.5", "nan 91.5", 1))
    (mine / "d_cut.npz").write_bytes(b"PK\x03\x04 and no more")
    np.savez(mine / "e_shape.npz", betas=np.zeros(10))
    (mine / "f_camera.bvh").write_text(Spelling(names=lambda n: "x" * (1 + len(n))).text())
    shown = command(mine, tmp_path / "corpus", "--json", tmp_path / "r.json")
    assert shown.exit_code == 1
    result = json.loads((tmp_path / "r.json").read_text())
    assert [row["clip"] for row in result["errors"]] == [
        "walks/b_empty", "walks/c_nan", "walks/d_cut", "walks/f_camera",
    ]  # fmt: skip
    assert "error: walks/b_empty: b_empty.bvh: the file is empty" in shown.stdout
    assert "warning: walks/e_shape: left out: e_shape.npz: no motion in it" in shown.stdout
    assert shown.stdout.splitlines()[-1].endswith("4 files could not be read")
    assert any(c.take == "walks/a" for c in Corpus.load(tmp_path / "corpus").clips)


def test_recordings_beside_archives_are_built_and_named_after_their_folder(tmp_path: Path) -> None:
    mine = tmp_path / "mine"
    (mine / "deepmimic").mkdir(parents=True)
    (mine / "deepmimic" / "walk.bvh").write_text(plain())
    (mine / "deepmimic" / "run.bvh").write_text("")
    (tmp_path / "walk.bvh").write_text(plain())
    with tarfile.open(mine / "more.tar.xz", "w:xz") as tar:
        tar.add(tmp_path / "walk.bvh", arcname="walk.bvh")
    manifest = build(mine, tmp_path / "corpus", amount=0.0)
    assert [row["clip"] for row in manifest["errors"]] == ["deepmimic/run"]
    assert {"deepmimic/walk", "mine/walk"} <= {c.take for c in Corpus.load(tmp_path / "corpus").clips}


def test_a_folder_without_a_usable_file_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    assert "no BVH, AMC or npz" in command(tmp_path / "in", tmp_path / "corpus").output
    (tmp_path / "in" / "a.bvh").write_text("")
    shown = command(tmp_path / "in", tmp_path / "corpus", "--json", tmp_path / "r.json")
    assert shown.exit_code == 1 and "can be used" in shown.output
    assert "the file is empty" in json.loads((tmp_path / "r.json").read_text())["error"]
    assert not (tmp_path / "corpus").exists()


@pytest.mark.parametrize("out", ["in", ".", "file", "file/below", "full"])
def test_nothing_but_a_corpus_is_replaced(tmp_path: Path, out: str) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "a.bvh").write_text(plain())
    (tmp_path / "file").write_text("x")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "letter.txt").write_text("mine")
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    shown = command(tmp_path / "in", tmp_path / out)
    assert shown.exit_code == 1 and "invalid_input" in shown.output and "Traceback" not in shown.output
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before


def test_a_corpus_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "a.bvh").write_text(plain())
    for _ in range(2):
        assert command(tmp_path / "in", tmp_path / "corpus").exit_code == 0


def _piece(p: Array, label: Label) -> Piece:
    return Piece("s/t", "s/t", "s", label, ("own words", "a person stands still"), p)


def test_jumps_gestures_and_what_is_low_are_told_from_standing() -> None:
    report = Report()
    still = _piece(stand(120), Label("stand", "stand"))
    assert seen([still], report) == [still]
    walk = _piece(stepping(), Label("walk", "walk"))
    assert seen([walk], report) == [walk]
    t = np.arange(120) / 30.0
    up = np.clip(t - 1.0, 0.0, 0.5)
    jump = stand(120) + np.stack([0 * t, 0 * t, 9.81 * up * (0.5 - up) / 2], axis=-1)[:, None]
    (jumped,) = seen([_piece(jump, Label("stand", "stand"))], report)
    assert jumped.label.behaviour == "jump"
    assert jumped.texts[0] == "own words" and "a person stands still" not in jumped.texts
    waving = stand(120)
    waving[:, J["left_wrist"], 2] += 0.3 * np.sin(2 * np.pi * t)
    (gesture,) = seen([_piece(waving, Label("stand", "stand"))], report)
    assert gesture.label == Label("gesture", "gesture")
    assert report.left_out == []
    low = stand(120) - [0.0, 0.0, 0.6]
    assert seen([_piece(low, Label("stand", "stand"))], report) == []
    assert "low on the floor" in report.left_out[0]["reason"]
