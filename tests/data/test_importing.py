"""Importing files: rates, axes and units that are said or assumed, bad files, names of outputs."""

from __future__ import annotations

import errno
import json
import os
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner, Result

from orchestrator.cli import main as cli
from shared.data.importer import import_path, load_clip
from shared.data.reading import read_all
from shared.motion.io.files import read_motion
from shared.motion.io.options import ReadOptions
from tests.data.captures import amc, asf, asf_amc, saved, smpl
from tests.data.walks import JOINTS, Spelling, plain


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


def test_a_file_that_may_not_be_read_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Refused by a patched read and not by the file's mode: root, as whom CI runs, may read everything."""
    (tmp_path / "walk.bvh").write_text(plain())
    read = Path.read_bytes

    def refused(path: Path) -> bytes:
        if path.name == "walk.bvh":
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
        return read(path)

    monkeypatch.setattr(Path, "read_bytes", refused)
    shown = command(tmp_path / "walk.bvh", tmp_path / "out")
    assert shown.exit_code == 1 and "error: walk.bvh: cannot be opened (Permission denied)" in shown.output


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
