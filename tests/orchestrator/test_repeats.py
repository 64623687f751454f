"""The same evaluation twice gives the same rows: with the real planner, and several characters at once."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("torch", reason="the real planner needs torch")


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_eval_text_repeats_bit_for_bit(tmp_path: Path) -> None:
    results = []
    for run in range(2):
        out = tmp_path / f"{run}.json"
        command = ["eval", "text", "--minutes", "0.4", "--parallel", "3", "--seed", "5", "--json", str(out)]
        subprocess.run([sys.executable, "-m", "motionloop", *command], check=True, capture_output=True, timeout=300)
        results.append(json.loads(out.read_text()))
    first, second = results
    assert first["deterministic"] is True
    assert first["fixed"]["planner_batch"] == 1
    assert len(first["rows"]) == 5
    assert first["rows"] == second["rows"]
