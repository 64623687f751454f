"""The simulation of a cluster against what can be worked out by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.cluster_simulation import Cluster, Costs, fits, orchestrator, planner, simulate, tracker

EXACT = Costs(batch_s=0.04, plan_s=0.05, tick_s=0.002, orchestrator=0.05, command_s=0.01, spread=0.0)
CALM = Cluster(shard=1, planned=1, host=1, commands_per_s=0.0)


def test_one_character_waits_for_its_own_plan_alone() -> None:
    found = planner(CALM, EXACT, 20.0, np.random.default_rng(1))
    assert found["late"] == 0.0
    assert (found["p50_ms"], found["p95_ms"]) == pytest.approx((90.0, 90.0))
    assert found["busy"] == pytest.approx(20 * 0.09 / 20.0)


def test_a_planner_that_is_asked_for_more_than_it_can_falls_behind_in_full_batches() -> None:
    """Batches of eight take 0.44 s: 18.2 plans a second at most."""
    found = planner(replace(CALM, planned=40), EXACT, 20.0, np.random.default_rng(1))
    assert found["busy"] > 0.97 and found["late"] > 0.9
    begun_at_once = planner(replace(CALM, planned=40, lead_s=1e9), EXACT, 20.0, np.random.default_rng(1))
    assert begun_at_once["late"] == 0.0


def test_ticks_are_missed_once_they_do_not_fit() -> None:
    """16 characters take 32 ms of 33.3; 18 take 36 and fall 2.7 ms further behind each tick."""
    assert tracker(replace(CALM, host=16), EXACT, 10.0, np.random.default_rng(1)) == pytest.approx(
        {"missed": 0.0, "busy": 16 * 0.002 * 30}
    )
    assert tracker(replace(CALM, host=18), EXACT, 10.0, np.random.default_rng(1))["missed"] > 0.9


def test_an_orchestrator_pays_for_characters_and_commands() -> None:
    assert orchestrator(replace(CALM, shard=10, commands_per_s=0.5), EXACT) == pytest.approx(10 * (0.05 + 0.5 * 0.01))


def test_the_sizes_found_fit_and_hold_all_characters() -> None:
    found = simulate(1000, EXACT, CALM, 10.0, seed=1)
    size = Cluster(**found["cluster"])
    assert fits(size, EXACT, 10.0, 1)
    assert size.host == 13, "four fifths of 33.3 ms hold 13 ticks of 2 ms"
    assert found["takes"]["orchestrators"] * size.shard >= 1000 and found["takes"]["trackers"] == 77
    assert size.shard == 16, "0.05 cores each"
    assert not fits(replace(size, planned=round(1.5 * size.planned)), EXACT, 10.0, 1)
