"""The command line over real processes."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import psutil
import pytest

from orchestrator.cli.braille import Canvas, side_view, top_view
from orchestrator.client import Client
from orchestrator.core.supervise import Stack, address_in
from orchestrator.evaluation.commands import DEFAULT, choose
from orchestrator.evaluation.rows import Measured
from orchestrator.evaluation.starts import Start, octant, start_of
from orchestrator.evaluation.statistics import percentiles
from orchestrator.evaluation.tasks import episode_spec, summary
from shared.errors import InvalidInputError
from shared.motion.ik import standing_clip
from shared.motion.rotations import wrap_angle
from shared.scenes.placing import mark_place
from shared.scenes.schema import Scene, SceneBody
from shared.statistics import wilson
from shared.tasks.obey import kind_of

MOTIONLOOP = [sys.executable, "-m", "motionloop"]
pytestmark = pytest.mark.timeout(900)  # many processes are started, on a machine that may be busy


def run(*arguments: str, code: int = 0) -> subprocess.CompletedProcess[str]:
    done = subprocess.run([*MOTIONLOOP, *arguments], capture_output=True, text=True, timeout=300)
    assert done.returncode == code, done.stderr + done.stdout
    return done


@pytest.fixture
def no_characters(stack: Stack) -> Iterator[None]:
    """End the characters that a test leaves."""
    yield
    with Client(stack.url) as client:
        for character in client.characters:
            character.close()


@pytest.mark.usefixtures("no_characters")
def test_say_swap_and_an_episode_file(stack: Stack, tmp_path: Path) -> None:
    assert "taken at tick" in run("say", "a person is standing still.", "--url", stack.url).stderr
    refused = run("say", "walk", "--target", "1", "--url", stack.url, code=1)
    assert "x,y,z" in refused.stderr
    far = run("say", "walk", "--target", "99,0,0", "--url", stack.url, code=1)
    assert "target.position_m" in far.stderr
    assert "within 30 m" in far.stderr
    assert "stand" in run("swap", "planner", "--plugin", "stand", "--url", stack.url).stderr
    assert "allowed: stand, clip" in run("swap", "planner", "--plugin", "x", "--url", stack.url, code=1).stderr
    file = tmp_path / "episode.yaml"
    file.write_text("seed: 2\ntasks:\n  - {type: halt, settle_s: 0.5, duration_s: 0.5}\n")
    out = tmp_path / "out"
    shown = run("episode", str(file), "--url", stack.url, "--json", str(tmp_path / "result.json"))
    assert "ok after" in shown.stderr
    episode = json.loads((tmp_path / "result.json").read_text())
    assert episode["success"] is True
    wanted = ["--out", str(out), "--formats", "npz,bvh,csv,glb", "--url", stack.url]
    run("export", episode["id"], *wanted)
    assert sorted(path.suffix for path in out.iterdir()) == [".bvh", ".csv", ".glb", ".npz"]
    listed = json.loads(run("export", "--json", str(tmp_path / "files.json"), *wanted).stdout)
    assert listed["episode"] == episode["id"]
    assert "allowed: npz, bvh, csv, glb, mp4" in run("export", *wanted, "--formats", "fbx", code=1).stderr
    file.write_text("tasks: [\n")
    assert "no YAML" in run("episode", str(file), "--url", stack.url, code=1).stderr


@pytest.mark.usefixtures("no_characters")
def test_say_and_swap_as_json_and_watch_by_numbers(stack: Stack, tmp_path: Path) -> None:
    url = ["--url", stack.url]
    assert "there is no character" in run("watch", "--seconds", "1", *url, code=1).stderr
    file = tmp_path / "out.json"
    told = json.loads(run("say", "walk", "--target", "1,0.5", "--json", str(file), *url).stdout)
    assert told == json.loads(file.read_text())
    assert (told["target"], told["joint"]) == ([1.0, 0.5], "traj")
    used = json.loads(run("swap", "--json", str(file), *url).stdout)
    assert (used["planner"]["plugin"], used["tracker"]["plugin"]) == ("stand", "kinematic")
    lines = tmp_path / "new" / "states.jsonl"
    view = run("watch", "--seconds", "2", "--json", str(lines), *url).stderr
    for words in ("side", "top", "plan latency", "traj (1.0, 0.5, 0.0)", told["character"][:8], "running"):
        assert words in view
    ticks = [json.loads(line)["tick"] for line in lines.read_text().splitlines()]
    assert ticks == sorted(set(ticks)) != []


def test_a_canvas_puts_dots_where_they_belong() -> None:
    canvas = Canvas(2, 1, (0.0, 0.0), 4.0)  # 4 x 4 dots, one a metre
    canvas.line((-1.5, 1.5), (-1.5, 1.5))
    canvas.line((1.5, -1.5), (1.5, -1.5))
    canvas.line((9.0, 9.0), (9.0, 9.0))
    assert canvas.lines() == ["\u2801\u2880"]
    standing = standing_clip(1, 30).positions_w_m[0]
    side = side_view(standing, 0.0)
    assert (len(side), {len(line) for line in side}) == (16, {22})
    floor = side[-1][0]
    assert side[-1].count(floor) > 15, "the floor is in the lowest line"
    assert floor not in "".join(side[:-1])
    assert floor != "\u2800"
    top = top_view(standing, target_xy_m=standing[0, :2] + [9.0, 0.0])
    assert any(cell != "\u2800" for cell in "".join(top[:3])), "a far target is drawn at the edge, here the upper one"
    assert top_view(standing)[:3] == ["\u2800" * 32] * 3


def test_without_a_server_it_says_what_to_do(free_port: Callable[[], int]) -> None:
    url = f"http://127.0.0.1:{free_port()}"
    for command in (["say", "walk"], ["watch"], ["swap"], ["export"]):
        said = run(*command, "--url", url, code=1).stderr
        assert "no server" in said
        assert "motionloop serve all" in said


def test_conformance_of_both_services(stack: Stack) -> None:
    for address in (stack.planner.address, stack.tracker.address):
        run("conformance", address)


def test_eval_tasks_writes_the_fields_and_resumes(tmp_path: Path) -> None:
    common = [
        "eval", "tasks", "--tasks", "halt", "--seed", "3", "--planner", "stand", "--tracker", "kinematic",
        "--resume", str(tmp_path / "rows.jsonl"), "--json", str(tmp_path / "result.json"),
    ]  # fmt: skip
    run(*common, "--episodes", "2")
    result = json.loads((tmp_path / "result.json").read_text())
    halt = result["tasks"]["halt"]
    assert (halt["n"], halt["success_strict"], halt["falls"]) == (2, 1.0, 0)
    assert halt["ci95"] == [round(v, 4) for v in wilson(2, 2)]
    assert result["seed"] == 3
    assert result["machine"]["cores"] >= 1
    assert len((tmp_path / "rows.jsonl").read_text().splitlines()) == 2


def test_eval_tasks_goes_on_after_a_kill_with_the_same_table(tmp_path: Path) -> None:
    """The file of a killed run: some rows, the last cut off. Who only stands strikes and sits on nothing."""
    rows = tmp_path / "rows.jsonl"
    command = [
        "eval", "tasks", "--tasks", "strike,sit,get_up", "--episodes", "2", "--planner", "stand",
        "--tracker", "kinematic", "--report", str(tmp_path / "report.md"), "--resume", str(rows),
        "--parquet", str(tmp_path / "rows.parquet"), "--json",
    ]  # fmt: skip
    run(*command, str(tmp_path / "whole.json"))
    whole_rows = (tmp_path / "rows.parquet").read_bytes()
    whole = json.loads((tmp_path / "whole.json").read_text())["tasks"]
    lines = rows.read_text().splitlines(keepends=True)
    assert len(lines) == 6
    rows.write_text("".join(lines[:3]) + lines[3][:40])
    run(*command, str(tmp_path / "again.json"), "--jobs", "2")
    assert json.loads((tmp_path / "again.json").read_text())["tasks"] == whole
    assert len(rows.read_text().splitlines()) == 6
    assert (tmp_path / "rows.parquet").read_bytes() == whole_rows
    assert {name: row["success_strict"] for name, row in whole.items()} == {"strike": 0.0, "sit": 0.0, "get_up": 0.0}
    assert whole["get_up"]["success_code"] is None, "none has sat, so that the release would count none"
    assert sum(part["n"] for part in whole["strike"]["by_octant"].values()) == 2
    assert "| strike | 2 | 0.000 |" in (tmp_path / "report.md").read_text()


def test_eval_text_judges_a_list_and_records_it_for_eval_planner(tmp_path: Path) -> None:
    sentences = tmp_path / "list.tsv"
    sentences.write_text("stand\tremain where you are\nwalk\tcarry on\n")
    run(
        "eval", "text", "--sentences", str(sentences), "--planner", "stand", "--tracker", "kinematic",
        "--every-s", "3", "--record", str(tmp_path / "done"), "--json", str(tmp_path / "result.json"),
    )  # fmt: skip
    result = json.loads((tmp_path / "result.json").read_text())
    assert (result["commands"], result["obeyed"], result["falls"]) == (2, 0.5, 0)
    assert result["by_kind"] == {"stand": {"n": 1, "obeyed": 1.0}, "walk": {"n": 1, "obeyed": 0.0}}
    recorded = sorted((tmp_path / "done").glob("*.npz"))
    assert len(recorded) == 2
    with np.load(recorded[0], allow_pickle=False) as data:
        assert data["body_pos_w_m"].shape[1:] == (22, 3)
        assert float(data["fps"]) == 30.0
        assert str(data["text"]) in ("remain where you are", "carry on")
    sentences.write_text("fly\tgo up\n")
    refused = run("eval", "text", "--sentences", str(sentences), code=1)
    assert "unknown kind" in refused.stderr and "walk_back" in refused.stderr


def test_a_failed_episode_is_filmed_and_a_variant_without_its_weights_is_refused(tmp_path: Path) -> None:
    common = ["eval", "tasks", "--tasks", "text", "--episodes", "1", "--planner", "stand", "--tracker", "kinematic"]
    run(*common, "--videos", str(tmp_path / "films"), "--json", str(tmp_path / "result.json"))
    result = json.loads((tmp_path / "result.json").read_text())
    assert result["tasks"]["text"]["success_strict"] == 0.0, "who stands does not walk"
    (film,) = (tmp_path / "films").iterdir()
    assert film.name == "text_closed_loop_1_000.mp4"
    assert film.read_bytes()[4:8] == b"ftyp"
    said = run(*common, "--variant", "no_finetune", code=1).stderr
    assert "--tracker-weights" in said


def test_starts_are_as_far_and_in_as_many_directions_as_in_the_paper() -> None:
    made = {task: [start_of(task, seed) for seed in range(300)] for task in ("strike", "sit")}
    for starts in made.values():
        octants = [octant(start.bearing_rad) for start in starts if start.bearing_rad is not None]
        assert min(np.bincount(octants, minlength=8)) > 15
    places = [np.hypot(*body_of(start).position_w_m[:2]) for start in made["strike"]]
    assert 1.0 <= min(places) < 1.05
    assert 1.45 < max(places) <= 1.5
    assert {start.tasks[0]["limb"] for start in made["strike"]} == {
        "left_hand", "right_hand", "left_foot", "right_foot",
    }  # fmt: skip
    for start in made["sit"]:
        assert isinstance(start.scene, Scene)
        seat = mark_place(start.scene, "seat_centre")
        assert 1.0 <= np.hypot(*seat.position_w_m[:2]) <= 1.2
        to_body = np.arctan2(-seat.position_w_m[1], -seat.position_w_m[0])
        assert abs(wrap_angle(to_body - seat.heading_rad)) <= np.pi / 3 + 1e-9
    assert [octant(angle) for angle in (0.0, 0.39, 0.40, np.pi / 2, np.pi, -np.pi / 2, -0.4)] == [0, 0, 1, 2, 4, 6, 7]
    assert start_of("strike", 5) == made["strike"][5]


def body_of(start: Start) -> SceneBody:
    """The one object of a start's scene."""
    assert isinstance(start.scene, Scene)
    return start.scene.bodies[0]


def test_serve_all_keeps_three_processes_up_and_ends_everything_on_sigterm(tmp_path: Path) -> None:
    process = subprocess.Popen(
        [*MOTIONLOOP, "serve", "all", "--port", "0", "--data-dir", str(tmp_path), "--planner", "stand"],
        stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stderr is not None
    said = ""
    while "/docs" not in said:
        said += process.stderr.readline()
    os.kill(int(re.findall(r"planner: \S+ \(pid (\d+)\)", " ".join(said.split()))[0]), signal.SIGKILL)
    while "is back" not in " ".join(said.split()):
        said += process.stderr.readline()
    assert "planner was killed by SIGKILL; it is started again" in " ".join(said.split())
    children = psutil.Process(process.pid).children(recursive=True)
    assert len(children) >= 3
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=60)
    assert process.returncode == 0
    _, alive = psutil.wait_procs(children, timeout=10)
    assert alive == []


def test_wilson_by_hand() -> None:
    low, high = wilson(90, 100)
    assert low == pytest.approx(0.8256, abs=1e-4)
    assert high == pytest.approx(0.9448, abs=1e-4)
    assert wilson(0, 0) == (0.0, 1.0)
    assert percentiles([1, 2, 3], 50, 95) == {"p50": 2.0, "p95": 2.9}
    assert percentiles([], 50) == {"p50": None}


def test_evaluations_ask_for_every_kind_and_know_their_names() -> None:
    commands = choose(60, 1)
    kinds: list[str] = [kind_of(asked.text) for asked in commands]
    assert {kind: kinds.count(kind) for kind in DEFAULT} == dict.fromkeys(DEFAULT, 10)
    assert all(kind_of(text) == kind for kind, texts in DEFAULT.items() for text in texts)
    assert choose(60, 1) == commands != choose(60, 2)
    with pytest.raises(InvalidInputError, match="fly"):
        episode_spec(("fly", 0), Measured())
    with pytest.raises(InvalidInputError, match="sideways"):
        episode_spec(("reach", 0), Measured(variant="sideways"))


def test_a_summary_counts_by_hand() -> None:
    row = {"index": 0, "strict": True, "paper": True, "code": True, "fell": False, "seconds": 4.0, "reason": None}
    bad = {**row, "index": 1, "strict": False, "paper": False, "fell": True, "reason": "fell"}
    result = summary([{**row, "measures": {}}, {**bad, "measures": {}}])
    assert (result["n"], result["success_strict"], result["success_paper"], result["success_code"]) == (2, 0.5, 0.5, 1)
    assert result["falls"] == 1
    assert result["median_time_s"] == 4.0
    assert result["failures"][0]["reason"] == "fell"


def test_ready_lines_of_all_services_are_understood() -> None:
    assert address_in("planner ready at tcp://127.0.0.1:42235 with stand") == "tcp://127.0.0.1:42235"
    assert address_in("tracker_service ready endpoint=tcp://127.0.0.1:1 state=tcp://127.0.0.1:2") == "tcp://127.0.0.1:1"
    assert address_in("ready http://127.0.0.1:8080") == "http://127.0.0.1:8080"
    assert address_in("listening on tcp://127.0.0.1:1") is None
