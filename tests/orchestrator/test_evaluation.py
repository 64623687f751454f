"""Evaluations of tasks without services: starts, sequences, rows of a measurement, statistics, report and plots."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from pydantic import TypeAdapter

from orchestrator.evaluation.pushes import Pushes
from orchestrator.evaluation.report import compared, write_report
from orchestrator.evaluation.rows import Measured, finished, keep
from orchestrator.evaluation.sequences import FREE_M, LENGTH, RETRIES, sequence_of
from orchestrator.evaluation.starts import SEAT_TOP_M, start_of
from orchestrator.evaluation.statistics import two_proportions_p
from orchestrator.evaluation.tasks import start_for, summary
from shared.protocol.control import Ok
from shared.protocol.messages import Impulse
from shared.scenes.placing import mark_place
from shared.scenes.schema import Scene
from shared.tasks.factory import TaskSpec, make_task


def scene_of(task: str, seed: int, varied: bool) -> Scene:
    scene = start_of(task, seed, varied).scene
    assert isinstance(scene, Scene)
    return scene


def test_varied_starts_have_other_sizes_and_the_same_directions() -> None:
    tops, distances, radii = [], [], []
    for seed in range(200):
        plain, varied = start_of("sit", seed), start_of("sit", seed, varied=True)
        assert varied.heading_rad == plain.heading_rad
        assert varied.bearing_rad == pytest.approx(plain.bearing_rad)
        seat = mark_place(scene_of("sit", seed, True), "seat_centre")
        tops.append(float(seat.position_w_m[2]))
        distances.append(float(np.hypot(*seat.position_w_m[:2])))
        bag = scene_of("strike", seed, True).bodies[0]
        radii.append(bag.parts[0].size_m[0])
        assert sum(part.mass_kg or 0.0 for part in bag.parts) == pytest.approx(63.0)
    assert SEAT_TOP_M[0] <= min(tops) < 0.22
    assert 0.58 < max(tops) <= SEAT_TOP_M[1] + 1e-9
    assert 0.8 <= min(distances) < 0.9
    assert 1.3 < max(distances) <= 1.44
    assert 0.24 * 0.8 <= min(radii) < 0.2 < 0.28 < max(radii) <= 0.24 * 1.2


def test_sequences_are_five_tasks_that_can_be_done_one_after_the_other() -> None:
    kinds: list[str] = []
    for seed in range(100):
        start = sequence_of(seed)
        assert len(start.tasks) == LENGTH
        assert isinstance(start.scene, Scene)
        for task, after in zip(start.tasks, [*start.tasks[1:], None], strict=True):
            make_task(TypeAdapter(TaskSpec).validate_python(task), seed)
            assert task["retries"] == RETRIES
            assert after is None or (task["type"] == "sit") == (after["type"] == "get_up")
            assert after is None or task["type"] != after["type"]
            if "position_m" in task:
                for mark in ("bag_centre", "seat_centre"):
                    away = mark_place(start.scene, mark).position_w_m[:2] - task["position_m"]
                    assert float(np.linalg.norm(away)) >= FREE_M
        kinds += [task["type"] for task in start.tasks]
    assert set(kinds) == {"reach", "strike", "sit", "get_up", "halt"}
    assert sequence_of(3) == sequence_of(3) != sequence_of(4)
    assert start_for(("sequence", 0), Measured(seed=1)) != start_for(("sequence", 0), Measured(seed=2))


def test_rows_of_another_measurement_or_cut_off_are_run_again(tmp_path: Path) -> None:
    path, measured = tmp_path / "rows.jsonl", Measured(seed=4, weights="a")
    others = (replace(measured, weights="b"), replace(measured, varied=True), replace(measured, push_ns=40.0))
    for other in (measured, *others, replace(measured, seed=5)):
        keep(path, other.stamped({"task": "sit", "index": other.seed, "strict": other == measured}))
    whole = path.read_text()
    path.write_text(whole + '{"task": "sit", "ind')
    rows = finished(path, measured)
    assert list(rows) == [("sit", 4)]
    assert rows["sit", 4]["strict"]
    assert path.read_text() == whole
    assert finished(tmp_path / "none.jsonl", measured) == {}


def test_rows_of_before_there_were_pushes_are_of_none(tmp_path: Path) -> None:
    path, measured = tmp_path / "rows.jsonl", Measured(seed=4, weights="a")
    row = measured.stamped({"task": "sit", "index": 0})
    del row["push_ns"]
    keep(path, row)
    assert list(finished(path, measured)) == [("sit", 0)]
    assert finished(path, replace(measured, push_ns=40.0)) == {}


def test_each_task_is_pushed_once_and_alike_in_every_variant() -> None:
    def pushed(seed: int) -> list[tuple[int, int, float]]:
        found: list[tuple[int, int, float]] = []
        runner: Any = SimpleNamespace(results=[], session=SimpleNamespace(loop=SimpleNamespace()))

        async def ask(kind: type[Ok], message: Impulse) -> Ok:
            found.append((len(runner.results), tick, float(np.linalg.norm(message.impulse_w_ns))))
            return Ok()

        runner.session.loop.ask_tracker = ask
        push = Pushes(runner, seed, 80.0)
        for tick in range(0, 400, 12):
            if tick == 204:
                runner.results.append("done")
            cycle: Any = SimpleNamespace(state=SimpleNamespace(tick=tick))
            asyncio.run(push(cycle))
        return found

    (first, at, hard), (second, later, _) = found = pushed(3)
    assert (first, second) == (0, 1)
    assert hard == pytest.approx(80.0)
    assert 15 <= at <= 75 + 12
    assert 15 <= later - 204 <= 75 + 12
    assert pushed(3) == found != pushed(4)


def test_two_proportions_by_hand() -> None:
    assert two_proportions_p(90, 100, 90, 100) == pytest.approx(1.0)
    # p = .85, spread = sqrt(.85 * .15 * 2 / 100) = .0505, z = .1 / .0505 = 1.980
    assert two_proportions_p(90, 100, 80, 100) == pytest.approx(0.0477, abs=2e-4)
    assert two_proportions_p(50, 50, 20, 20) == 1.0


def result_of(good: int, n: int, variant: str) -> dict[str, Any]:
    row = {"paper": True, "code": True, "fell": False, "seconds": 4.0, "measures": {}}
    rows = [
        {**row, "index": i, "strict": i < good, "octant": i % 8, "reason": None if i < good else "timed out"}
        for i in range(n)
    ]
    return {"tasks": {"sit": summary(rows)}, "variant": variant, "seed": 1}


def test_a_report_shows_its_plots_and_a_comparison(tmp_path: Path) -> None:
    here, there = result_of(30, 40, "closed_loop"), result_of(10, 40, "open_loop")
    write_report(tmp_path / "out" / "tasks.md", here, there)
    text = (tmp_path / "out" / "tasks.md").read_text()
    assert "| sit | 0.750 | 40 | 0.250 | 40 |" in text
    assert "sit failed: timed out 10" in text
    bars, roses = (tmp_path / "out" / f"tasks_{name}.svg" for name in ("success", "directions"))
    svg = "{http://www.w3.org/2000/svg}"
    heights = [float(rect.get("height", "0")) for rect in ElementTree.parse(bars).iter(f"{svg}rect") if rect.get("x")]
    assert heights[:3] == pytest.approx([135.0, 180.0, 180.0])  # of 180: .75, 1 and 1
    assert len(list(ElementTree.parse(roses).iter(f"{svg}path"))) == 8
    assert "tasks_success.svg" in text
    assert "tasks_directions.svg" in text
    assert "| sit |" not in compared(here, {**there, "tasks": {}})
