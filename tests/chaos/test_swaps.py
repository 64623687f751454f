"""Planner and tracker are exchanged under four running characters, which go on. `tests.chaos.swaps` is the long one."""

from __future__ import annotations

from pathlib import Path

from tests.chaos.swaps import CHARACTERS, TURNS, swaps


def test_characters_go_on_through_swaps_of_planner_and_tracker(tmp_path: Path) -> None:
    found = swaps(tmp_path, every_s=0.0, seconds=0.0)
    assert found["swaps"] == len(TURNS)
    assert found["status"] == ["running"] * CHARACTERS
    assert found["step_m"] < 0.05, "a character that stands was not put anywhere else"
