"""The diffusion's constants by hand, its sampler on a known denoiser, and the network's shapes and masks."""

from __future__ import annotations

import math

import pytest
import torch

from planner_service.dip.conditions import TARGET_NUMBERS
from planner_service.dip.config import preset
from planner_service.dip.diffusion import add_noise, cosine_schedule, respaced, sample, sample_some, spread_steps
from planner_service.dip.network import DipNetwork, parameter_count, whiten_text
from shared.errors import InvalidInputError


def test_cosine_schedule_follows_its_formula() -> None:
    schedule = cosine_schedule(10)

    def level(t: float) -> float:
        return math.cos((t + 0.008) / 1.008 * math.pi / 2) ** 2

    for i in range(9):
        assert abs(float(schedule.alpha_bar[i]) - level((i + 1) / 10) / level(0)) < 1e-6
    assert float(schedule.alpha_bar[9]) < 1e-3
    assert float(schedule.sigma[0]) == 0.0
    assert float(schedule.x0_weight[0]) == 1.0


def test_posterior_of_one_middle_step_by_hand() -> None:
    schedule = cosine_schedule(4)
    a0, a1 = float(schedule.alpha_bar[0]), float(schedule.alpha_bar[1])
    beta = 1 - a1 / a0
    assert abs(float(schedule.x0_weight[1]) - math.sqrt(a0) * beta / (1 - a1)) < 1e-6
    assert abs(float(schedule.xt_weight[1]) - math.sqrt(1 - beta) * (1 - a0) / (1 - a1)) < 1e-6
    assert abs(float(schedule.sigma[1]) ** 2 - beta * (1 - a0) / (1 - a1)) < 1e-6


def test_fewer_steps_have_the_noise_levels_of_those_they_are_and_the_way_between_them() -> None:
    every = cosine_schedule(10)
    some = respaced(every, [0, 4, 9])
    torch.testing.assert_close(some.alpha_bar, every.alpha_bar[[0, 4, 9]])
    a0, a4 = float(every.alpha_bar[0]), float(every.alpha_bar[4])
    assert abs(float(some.xt_weight[1]) - math.sqrt(a4 / a0) * (1 - a0) / (1 - a4)) < 1e-6
    assert abs(float(some.x0_weight[1]) - math.sqrt(a0) * (1 - a4 / a0) / (1 - a4)) < 1e-6
    for field in ("x0_weight", "xt_weight", "sigma"):
        torch.testing.assert_close(getattr(respaced(every, range(10)), field), getattr(every, field))


def test_steps_are_spread_from_the_noisiest_to_the_cleanest() -> None:
    assert spread_steps(10, 10) == list(range(10))
    assert spread_steps(10, 4) == [0, 3, 6, 9]
    assert spread_steps(10, 1) == [9], "from pure noise, or what comes out is no plan"


def test_noise_keeps_unit_variance() -> None:
    schedule = cosine_schedule(10)
    generator = torch.Generator().manual_seed(0)
    x0, noise = (torch.randn(10, 40, 263, generator=generator) for _ in range(2))
    noisy = add_noise(schedule, x0, torch.arange(10), noise)
    assert abs(float(noisy.var()) - 1.0) < 0.01


def test_sampler_ends_at_what_the_denoiser_says() -> None:
    target = torch.randn(2, 40, 263)
    seen = []

    def denoise(x: torch.Tensor, step: int) -> torch.Tensor:
        seen.append(step)
        return target

    out = sample(cosine_schedule(10), denoise, torch.randn(10, 2, 40, 263))
    assert seen == list(range(9, -1, -1))
    torch.testing.assert_close(out, target)


def test_small_and_full_have_the_stated_sizes() -> None:
    assert 6e6 < parameter_count(DipNetwork(preset("small"))) < 7.5e6
    assert 24e6 < parameter_count(DipNetwork(preset("full"))) < 30e6


@pytest.mark.parametrize("norm_first", [True, False])
def test_masked_text_does_not_count_and_shapes_hold(norm_first: bool) -> None:
    torch.manual_seed(0)
    network = DipNetwork(preset("tiny").model_copy(update={"norm_first": norm_first})).eval()
    noisy, prefix = torch.randn(3, 40, 263), torch.randn(3, 20, 263)
    targets, text = torch.randn(3, TARGET_NUMBERS), torch.randn(3, 5, 384)
    mask = torch.tensor([[1, 1, 1, 0, 0], [1, 1, 0, 0, 0], [0, 0, 0, 0, 0]], dtype=torch.bool)
    step = torch.tensor([0, 5, 9])
    out = network(noisy, step, prefix, targets, text, mask)
    assert out.shape == (3, 40, 263)
    changed = text.clone()
    changed[0, 3:], changed[1, 2:], changed[2] = 9.0, -9.0, 5.0
    torch.testing.assert_close(network(noisy, step, prefix, targets, changed, mask), out)
    changed[0, 0] += 1.0
    assert not torch.allclose(network(noisy, step, prefix, targets, changed, mask)[0], out[0])


def test_unknown_size_names_the_known_ones() -> None:
    with pytest.raises(InvalidInputError) as caught:
        preset("huge")
    assert caught.value.field == "size"
    assert "small" in str(caught.value.allowed)


def test_whitening_evens_out_what_sentences_differ_in() -> None:
    torch.manual_seed(0)
    network = DipNetwork(preset("tiny"))
    spread = torch.linspace(1.0, 0.2, 384)
    pooled = 3.0 + torch.randn(2000, 384) * spread
    whiten_text(network, pooled, damping=0.0)
    white = (pooled - network.text_mean) @ network.text_whitening
    assert white.shape == (2000, 16)
    torch.testing.assert_close(white.T @ white / 2000, torch.eye(16), atol=1e-3, rtol=0)


def test_few_sentences_leave_the_rest_of_the_whitening_zero() -> None:
    network = DipNetwork(preset("tiny"))
    whiten_text(network, torch.randn(5, 384))
    assert not network.text_whitening[:, 5:].any()
    assert torch.isfinite(network.text_whitening).all()


def test_what_was_begun_is_gone_on_with_to_the_same_end() -> None:
    schedule, noise = cosine_schedule(10), torch.randn(10, 3, 4, 5, generator=torch.Generator().manual_seed(0))

    def denoise(x: torch.Tensor, number: int) -> torch.Tensor:
        return torch.tanh(x) * (1 + number)

    whole = sample(schedule, denoise, noise)
    foreseen, begun = sample_some(schedule, denoise, noise, 4)
    assert foreseen.shape == begun.shape == whole.shape
    kept = [2, 0]
    assert torch.equal(sample(schedule, denoise, noise[:, kept], begun[kept], 4), whole[kept])
