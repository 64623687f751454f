"""The command line without a server: every command starts, says what it takes, and refuses in one line."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from orchestrator.cli import main as cli
from orchestrator.cli import measure
from shared.motion.ik import clip_from_positions, standing_clip
from shared.motion.io.bvh import write_bvh
from shared.motion.io.options import ReadOptions
from tests.data.samples import stepping
from tests.data.walks import Spelling
from tracker_service.training import evaluate_clips
from tracker_service.training.evaluate_clips import motions_of_files

IN_PROCESS = CliRunner(env={"COLUMNS": "200", "TERM": "dumb"})


def run(*arguments: str, code: int = 0) -> str:
    """Output of the command in a process of its own."""
    done = subprocess.run(
        [sys.executable, "-m", "motionloop", *arguments], capture_output=True, text=True, timeout=150, check=False
    )
    assert done.returncode == code, done.stderr + done.stdout
    assert "Traceback" not in done.stderr
    return done.stdout + done.stderr


@pytest.fixture(scope="module", autouse=True)
def _all_commands() -> None:
    names = {group.name for group in cli.app.registered_groups}
    if "eval" not in names:
        cli._add_measurements()


@pytest.mark.parametrize(
    ("command", "mentions"),
    [
        ("", ("serve", "demo", "say", "episode", "swap", "export", "conformance", "data", "train", "eval", "bench")),
        ("serve", ("planner", "--port")),
        ("swap", ("--plugin", "--endpoint")),
        ("export", ("--formats", "bvh")),
        ("conformance", ("ENDPOINT", "--plugin")),
        ("data import", ("BVH", "OUT")),
        ("data build", ("MOTIONLOOP_MOCAP", "--seed")),
        ("eval tasks", ("--episodes", "--variant", "--json")),
        ("eval text", ("--minutes", "--json")),
        ("bench loop", ("--characters", "--seconds", "--json")),
    ],
)
def test_help_says_what_a_command_takes(command: str, mentions: tuple[str, ...]) -> None:
    shown = IN_PROCESS.invoke(cli.app, [*command.split(), "--help"])
    assert shown.exit_code == 0
    for word in mentions:
        assert word.lower() in shown.output.lower()


@pytest.mark.parametrize(
    "arguments",
    [
        ["serve", "dragon"],
        ["swap", "orchestrator", "--plugin", "x"],
        ["eval", "tasks", "--episodes", "0"],
        ["data", "import", "/nowhere", "/tmp/out"],
        ["data", "build", "/nowhere", "/tmp/out"],
        ["bench", "loop", "--characters", "0"],
    ],
)
def test_wrong_use_is_told(arguments: list[str]) -> None:
    refused = IN_PROCESS.invoke(cli.app, arguments)
    assert refused.exit_code == 2
    assert "Usage" in refused.output


@pytest.mark.parametrize("option", ["--json", "--report"])
def test_a_result_that_cannot_be_written_is_told_before_the_work(
    option: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(measure, "with_executor", lambda *_, **__: pytest.fail("it was measured first"))
    refused = IN_PROCESS.invoke(cli.app, ["eval", "tasks", "--tasks", "halt", option, str(tmp_path)])
    assert refused.exit_code == 1 and "it is a folder" in refused.output


def test_what_is_no_earlier_result_is_told_before_the_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measure, "with_executor", lambda *_, **__: pytest.fail("it was measured first"))
    for text in ("[]", "{}", "no JSON"):
        (tmp_path / "other.json").write_text(text)
        refused = IN_PROCESS.invoke(cli.app, ["eval", "tasks", "--against", str(tmp_path / "other.json")])
        assert refused.exit_code == 1 and "invalid_input" in refused.output


@pytest.mark.parametrize(
    "command",
    [
        "train planner --out {out}",
        "train tracker --out {out}",
        "train tracker --ppo --out {out}",
        "eval planner --seed 2",
    ],
)
def test_training_and_evaluation_start_and_a_missing_corpus_is_one_clear_line(command: str, tmp_path: Path) -> None:
    arguments = command.format(out=tmp_path / "out").split()
    said = run(*arguments, "--corpus", str(tmp_path / "none"), code=1)
    assert "invalid_input in corpus" in said
    assert "holds no corpus" in said


def test_a_peer_that_is_not_there_is_told(tmp_path: Path) -> None:
    shown = IN_PROCESS.invoke(cli.app, ["conformance", f"ipc://{tmp_path}/nobody"])
    assert shown.exit_code == 1
    shown = IN_PROCESS.invoke(cli.app, ["conformance", "udp://127.0.0.1:1"])
    assert shown.exit_code == 1


def test_import_reports_each_file_and_fails_when_one_cannot_be_read(tmp_path: Path) -> None:
    source = tmp_path / "in"
    source.mkdir()
    (source / "bad.bvh").write_text("not motion")
    assert IN_PROCESS.invoke(cli.app, ["data", "import", str(source), str(tmp_path / "out")]).exit_code == 1
    write_bvh(source / "good.bvh", clip_from_positions(stepping(), 30.0, rebuild=True))
    shown = IN_PROCESS.invoke(cli.app, ["data", "import", str(source), str(tmp_path / "out")])
    assert shown.exit_code == 1
    assert "error: bad.bvh: line 1: not BVH: 'not motion'" in shown.output
    assert shown.output.strip().endswith("1 imported, 1 could not be read")
    assert (tmp_path / "out" / "good.npz").is_file()
    (source / "bad.bvh").unlink()
    assert IN_PROCESS.invoke(cli.app, ["data", "import", str(source), str(tmp_path / "out")]).exit_code == 0


def test_eval_tracker_follows_a_folder_of_clips(tmp_path: Path) -> None:
    """The behaviour is the folder's name; what cannot be read is said and left out."""
    clips = tmp_path / "clips"
    (clips / "stand").mkdir(parents=True)
    write_bvh(clips / "stand" / "still.bvh", standing_clip(60, 30.0))
    (clips / "broken.bvh").write_text("not motion")
    result_file = tmp_path / "result.json"
    run("eval", "tracker", "--clips", str(clips), "--tracker", "pd", "--seed", "3", "--json", str(result_file), code=1)
    result = json.loads(result_file.read_text())
    assert (result["clips"], result["success"], result["seed"]) == (1, 1.0, 3)
    assert {"mpjpe_mm", "velocity_error_mps", "falls_per_min", "by_behaviour", "per_clip", "machine"} <= result.keys()
    assert result["by_behaviour"]["stand"]["clips"] == 1
    assert list(result["left_out"]) == list(result["errors"]) == ["broken.bvh"]
    (clips / "stand" / "still.bvh").unlink()
    motions, outcomes = motions_of_files(clips)
    assert motions == [] and [outcome.label for outcome in outcomes] == ["broken.bvh"]


def test_eval_tracker_reads_clips_as_it_is_told(tmp_path: Path) -> None:
    """Rate and map reach the readers; without a clip to follow the result is written all the same."""
    clips = tmp_path / "clips"
    clips.mkdir()
    (clips / "walk.bvh").write_text(Spelling(names={"LeftUpLeg": "Bone_13"}, frame_time="33.333").text())
    told: list[str] = []
    options = ReadOptions(fps=60.0, joints={"left_hip": "Bone_13"})
    (motion,), (outcome,) = motions_of_files(clips, options, told.append)
    assert outcome.loaded is not None and outcome.loaded.fps == 60.0 and len(motion.positions_w_m) == 45
    assert told[0].startswith("walk.bvh  60 fps") and told[1].startswith("warning: walk.bvh: Frame Time 33.333 s")
    result_file = tmp_path / "result.json"
    said = run("eval", "tracker", "--clips", str(clips), "--json", str(result_file), code=1)
    assert "error: walk.bvh: Frame Time 33.333 s" in said and "can be followed" in said
    result = json.loads(result_file.read_text())
    assert result["clips"] == 0 and list(result["errors"]) == ["walk.bvh"]
    assert "can be followed" in result["error"]
    run("eval", "tracker", "--clips", str(tmp_path / "nowhere"), "--json", str(result_file), code=1)
    assert "no motion files" in json.loads(result_file.read_text())["error"]


@pytest.mark.parametrize(
    "wrong", [["--suite", "dragons"], ["--suite", "stand", "--clips", "."], [], ["--clips", ".", "--corpus", "."]]
)
def test_an_evaluation_of_the_tracker_that_is_asked_wrongly_is_refused_at_once(
    wrong: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(evaluate_clips, "cached_corpus", lambda _: pytest.fail("a corpus was built first"))
    assert IN_PROCESS.invoke(evaluate_clips.app, wrong).exit_code == 2
