"""The short chaos: faults of every row, by a fixed seed, over running episodes. `make chaos` is the long one."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.chaos.faults import FAULTS, shuffled
from tests.chaos.run import chaos, sound

SHORT = (
    "planner killed",
    "planner cut off",
    "tracker killed",
    "orchestrator killed",
    "planner: corrupt",
    "tracker: drop",
    "disk full",
    "store locked",
    "plans of NaN",
    "a planner that lies",
    "flood of episodes",
)
SEED = 7
REASONS = ("cancelled", "stand gave non-finite values", "the planner stayed away", "the tracker is gone")
"""Plans of NaN, one after the other, end an episode; so does a service that takes minutes to start."""


@pytest.mark.timeout(1200)
def test_no_episode_is_lost_or_stuck_and_no_tick_is_missing(tmp_path: Path) -> None:
    faults = [fault for fault in shuffled(len(FAULTS), SEED) if fault.name in SHORT]
    assert len(faults) == len(SHORT)
    assert {fault.row for fault in faults} == {fault.row for fault in FAULTS}
    found = chaos(faults, SEED, tmp_path, most_s=3600.0)
    assert sound(found), {name: found[name] for name in ("stuck", "stood_still", "lost", "wrong_recordings")}
    assert found["faults"] == len(SHORT)
    assert all(reason.startswith(REASONS) for reason in found["reasons"]), found["reasons"]
    assert any("non-finite" in reason for reason in found["reasons"]), "plans of NaN are said to be that"
