"""`motionloop demo`: what it leaves, and an exit code that tells whether every task succeeded."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from orchestrator.cli.demo import TASKS
from orchestrator.core.supervise import Stack
from shared.motion.io.bvh import read_bvh


def demo(*arguments: str) -> tuple[int, str]:
    command = [sys.executable, "-m", "motionloop", "demo", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    said = done.stdout + done.stderr
    assert "Traceback" not in said
    return done.returncode, said


def check_files(out: Path, names: Sequence[str] = tuple(task["name"] for task in TASKS)) -> dict[str, object]:
    """The result; the recording and its exports are of the same length."""
    result = json.loads((out / "result.json").read_text())
    with np.load(out / "episode.npz", allow_pickle=False) as data:
        ticks = len(data["body_pos_w_m"])
    assert ticks == round(result["simulated_s"] * 30) + 1
    assert len(read_bvh(out / "episode.bvh").positions_w_m) == ticks
    assert (out / "episode.glb").read_bytes()[:4] == b"glTF"
    assert [task["name"] for task in result["tasks"]] == list(names)
    return dict(result)


def test_a_planner_that_only_stands_fails_the_demo_and_all_files_are_there(stack: Stack, tmp_path: Path) -> None:
    code, said = demo("--url", stack.url, "--out", str(tmp_path / "new" / "demo"), "--no-video", "--seed", "2")
    assert code == 1, said
    result = check_files(tmp_path / "new" / "demo")
    assert (result["success"], result["seed"], result["status"]) == (False, 2, "finished")


def test_another_episode_is_shown_by_its_file(stack: Stack, tmp_path: Path) -> None:
    file = tmp_path / "stand.yaml"
    file.write_text("name: still\nscene: bag\ntasks:\n  - {type: halt, name: stand, duration_s: 1}\n")
    code, said = demo("--url", stack.url, "--out", str(tmp_path / "demo"), "--no-video", "--episode", str(file))
    assert code == 0, said
    assert check_files(tmp_path / "demo", ("stand",))["success"]
    file.write_text("- nothing")
    code, said = demo("--url", stack.url, "--out", str(tmp_path / "demo"), "--episode", str(file))
    assert code == 1, said


def test_what_cannot_be_is_told_before_anything_starts(stack: Stack, tmp_path: Path) -> None:
    code, said = demo("--url", stack.url, "--planner", "dip", "--out", str(tmp_path / "demo"))
    assert code == 2
    assert "motionloop swap" in said
    (tmp_path / "file").write_text("")
    code, said = demo("--out", str(tmp_path / "file"), "--no-video")
    assert code == 1
    assert "file" in said and "planner:" not in said


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_demo_as_shipped_succeeds(tmp_path: Path) -> None:
    """With services of its own, the real planner and tracker, and the video."""
    pytest.importorskip("torch", reason="the real planner needs torch")
    code, said = demo("--out", str(tmp_path), "--seed", "1")
    assert code == 0, said
    assert check_files(tmp_path)["success"] is True
    assert (tmp_path / "video.mp4").read_bytes()[4:8] == b"ftyp"
