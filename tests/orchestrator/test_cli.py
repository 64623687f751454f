"""The command line over real processes."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

import httpx
import psutil
import pytest

from orchestrator.core.supervise import Stack, address_in
from orchestrator.evaluation.statistics import percentiles, wilson
from orchestrator.evaluation.tasks import episode_spec, summary
from orchestrator.evaluation.text import COMMANDS, choose_commands
from shared.errors import InvalidInputError
from shared.tasks.obey import kind_of

MOTIONLOOP = [sys.executable, "-m", "motionloop"]


def run(*arguments: str, code: int = 0) -> subprocess.CompletedProcess[str]:
    done = subprocess.run([*MOTIONLOOP, *arguments], capture_output=True, text=True, timeout=300)
    assert done.returncode == code, done.stderr + done.stdout
    return done


def test_say_swap_and_an_episode_file(stack: Stack, tmp_path: Path) -> None:
    assert "taken at tick" in run("say", "a person is standing still.", "--url", stack.url).stderr
    refused = run("say", "walk", "--target", "1,2", "--url", stack.url, code=1)
    assert "x,y,z" in refused.stderr
    far = run("say", "walk", "--target", "99,0,0", "--url", stack.url, code=1)
    assert "target.position_m" in far.stderr
    assert "within 30 m" in far.stderr
    assert "stand" in run("swap", "planner", "--plugin", "stand", "--url", stack.url).stderr
    file = tmp_path / "episode.yaml"
    file.write_text("seed: 2\ntasks:\n  - {type: halt, settle_s: 0.5, duration_s: 0.5}\n")
    out = tmp_path / "out"
    run("episode", str(file), "--url", stack.url, "--json", str(tmp_path / "result.json"))
    episode = json.loads((tmp_path / "result.json").read_text())
    assert episode["success"] is True
    run("export", episode["id"], "--out", str(out), "--formats", "npz,bvh,csv", "--url", stack.url)
    assert sorted(path.suffix for path in out.iterdir()) == [".bvh", ".csv", ".npz"]
    with httpx.Client(base_url=stack.url) as http:
        for item in http.get("/v1/characters").json()["items"]:
            http.delete(f"/v1/characters/{item['id']}")


def test_without_a_server_it_says_so(free_port: object) -> None:
    assert callable(free_port)
    assert "no server" in run("say", "walk", "--url", f"http://127.0.0.1:{free_port()}", code=1).stderr


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


def test_serve_all_ends_everything_on_sigterm(tmp_path: Path) -> None:
    process = subprocess.Popen(
        [*MOTIONLOOP, "serve", "all", "--port", "0", "--data-dir", str(tmp_path), "--planner", "stand"],
        stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stderr is not None
    for line in process.stderr:
        if "/docs" in line:
            break
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
    commands = choose_commands(60, 1)
    kinds: list[str] = [kind_of(text) for text in commands]
    assert {kind: kinds.count(kind) for kind in COMMANDS} == dict.fromkeys(COMMANDS, 10)
    assert all(kind_of(text) == kind for kind, texts in COMMANDS.items() for text in texts)
    assert choose_commands(60, 1) == commands != choose_commands(60, 2)
    with pytest.raises(InvalidInputError, match="fly"):
        episode_spec("fly", 0, 1, "closed_loop", None, None)
    with pytest.raises(InvalidInputError, match="sideways"):
        episode_spec("reach", 0, 1, "sideways", None, None)


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
