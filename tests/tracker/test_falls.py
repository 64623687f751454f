"""Bodies that are knocked over lie, and what is asked of them from there is a way up."""

from __future__ import annotations

import numpy as np

from shared.motion.ik import standing_clip
from shared.motion.rise import between
from tracker_service.policy.learned import WEIGHTS
from tracker_service.simulation.character_spec import character
from tracker_service.simulation.humanoid import humanoid
from tracker_service.training.falls import fall, falls, got_up, upright_references, ways_up
from tracker_service.training.policies import policy_of

HUMAN = humanoid(character("human"))


def test_knocked_over_bodies_lie_and_their_ways_lead_up() -> None:
    settings, policy = policy_of(HUMAN, WEIGHTS)
    upright = upright_references(HUMAN, None)
    qpos, lying = fall(HUMAN, upright, settings, policy, count=8, seed=3)
    assert len(qpos) == len(lying) >= 6
    assert (lying[:, 0, 2] < 0.45).all() and lying[..., 2].min() > -0.05
    again, _ = fall(HUMAN, upright, settings, policy, count=8, seed=3)
    np.testing.assert_array_equal(qpos, again)
    library = [between(lying[0], standing_clip(2, 30.0).positions_w_m[0], np.linspace(0, 1, 60), HUMAN.skeleton)]
    ways = ways_up(HUMAN, lying, library, 1.0)
    for way, pose in zip(ways, lying, strict=True):
        np.testing.assert_allclose(way.positions_w_m[0], pose, atol=1e-6)
        assert way.positions_w_m[-1, 0, 2] > 0.9
    result = falls(HUMAN, settings, policy, upright, library, count=8, seed=3)
    assert result["falls"] == len(lying)
    assert sum(row["n"] for row in result["by_facing"].values()) == len(lying)
    assert 0.0 <= result["got_up"] <= 1.0


def test_getting_up_needs_both_feet_half_a_second_and_to_stay_up() -> None:
    ticks = 210
    height = np.full((ticks, 4), 0.3)
    feet = np.ones((ticks, 4), dtype=bool)
    height[60:, 0] = 0.9  # up at two seconds, stays
    height[60:80, 1] = 0.9  # up, and down again within a second
    height[60:, 2] = 0.9
    feet[:, 2] = False  # never on both feet
    height[190:, 3] = 0.9  # too late
    assert got_up(height, feet).tolist() == [True, False, False, False]
