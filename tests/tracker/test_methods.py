"""The comparison of both ways of learning: judged when so much was learnt, finished runs kept, a table by hand."""

from __future__ import annotations

import json
from itertools import count
from pathlib import Path
from typing import Any

from benchmarks.tracker_methods import finished, learn, table


class Counting:
    """Learns ten samples an iteration."""

    def __init__(self) -> None:
        self.samples = 0

    def iterate(self) -> dict[str, float]:
        self.samples += 10
        return {}

    def judge(self) -> dict[str, Any]:
        return {"success": self.samples / 1000, "mpjpe_mm": 50.0, "falls_per_min": 2.0, "clips": 3}


def test_it_is_judged_at_every_mark_and_judging_takes_no_time() -> None:
    ticks = count()
    rows = learn(Counting(), [5.0, 12.0], clock=lambda: float(next(ticks)))
    assert [row["seconds"] for row in rows] == [5.0, 12.0]
    assert rows[0]["samples"] == 40 and rows[1]["samples"] == 100
    assert rows[1]["success"] == 0.1 and "clips" not in rows[1]


def test_runs_that_were_cut_off_are_done_again(tmp_path: Path) -> None:
    runs = (("ppo", 0, 0), ("ppo", 0, 1), ("world", 0, 0))
    rows = [{"method": m, "seed": s, "mark": k, "mark_s": 60.0 * (k + 1)} for m, s, k in runs]
    path = tmp_path / "rows.jsonl"
    assert finished(path, [60.0, 120.0]) == []
    path.write_text("".join(json.dumps(row) + "\n" for row in rows))
    assert finished(path, [60.0, 120.0]) == rows[:2]
    assert finished(path, [150.0, 300.0]) == []  # the same marks at other times are other runs


def test_the_table_has_mean_least_and_most_of_the_seeds() -> None:
    rows = [
        {
            "method": "world",
            "seed": s,
            "mark": 0,
            "samples": 200_000,
            "success": v,
            "mpjpe_mm": 40,
            "falls_per_min": 1.0,
        }
        for s, v in enumerate((0.5, 0.6, 0.7))
    ]
    lines = table(rows, [150.0]).splitlines()
    assert len(lines) == 3
    assert lines[2] == "| world | 2.5 | 3 | 0.20 M | 0.600 (0.500-0.700) | 40 (40-40) | 1.0 (1.0-1.0) |"
