"""The benchmark of plans compares what it says: plans that are the same, made in two ways, and every number there."""

from __future__ import annotations

import pytest
import torch

from planner_service.benchmarks.plain import PlainDip
from planner_service.benchmarks.plan_cost import largest_difference_m, measure, planners
from planner_service.dip.config import preset
from planner_service.dip.features_torch import Normalizer
from planner_service.dip.network import DipNetwork
from planner_service.dip.planner import DipSettings
from planner_service.dip.weights import DipWeights
from shared.motion.features import global_to_features
from tests.planner.dip_helpers import HashEncoder, moving_body

SETTINGS = DipSettings(runtime="torch", bf16=False)


@pytest.fixture(scope="module")
def weights() -> DipWeights:
    torch.manual_seed(1)
    features = torch.from_numpy(global_to_features(moving_body(200, 20.0), 20)).float()
    normalizer = Normalizer(features.mean(0), features.std(0).clamp_min(0.02) * 0.1)
    return DipWeights(DipNetwork(preset("tiny")).eval().requires_grad_(False), normalizer, "0" * 64)


def test_every_number_is_there_for_each_planner(weights: DipWeights) -> None:
    compared = planners(weights, weights, HashEncoder(), SETTINGS)
    found = measure(compared, repeats=1, batch=2)
    assert list(found) == ["full_plain", "full", "small"]
    for numbers in found.values():
        assert set(numbers) == {"cpu_ms_per_plan_b1", "wall_ms_b1", "cpu_ms_per_plan_b2", "wall_ms_b2"}
        assert all(number > 0 for number in numbers.values())


def test_plans_in_use_are_those_of_the_network_run_plainly(weights: DipWeights) -> None:
    assert largest_difference_m(weights, HashEncoder(), SETTINGS) < 1e-4


def test_the_plain_way_is_two_passes_at_each_of_ten_steps(weights: DipWeights, monkeypatch: pytest.MonkeyPatch) -> None:
    passes: list[int] = []
    forward = DipNetwork.forward

    def counted(self: DipNetwork, noisy: torch.Tensor, *rest: torch.Tensor) -> torch.Tensor:
        passes.append(len(noisy))
        return forward(self, noisy, *rest)

    monkeypatch.setattr(DipNetwork, "forward", counted)
    compared = planners(weights, weights, HashEncoder(), SETTINGS.model_copy(update={"steps": 4}))
    measure({"full_plain": compared["full_plain"]}, repeats=1, batch=1)
    assert passes == [1] * 20 * 4, "warm-up and measurement, twice each at a batch of one"
    assert isinstance(compared["full_plain"]._dip, PlainDip)
