"""DiP for use gives what the network that was trained gives: every size, every condition, alone and in a batch."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from planner_service.dip.blocks import TorchBlocks
from planner_service.dip.conditions import KEYFRAME_NUMBERS, TARGET_NUMBERS, VELOCITY_NUMBERS
from planner_service.dip.config import DipConfig, preset
from planner_service.dip.folded import Conditions, FoldedDip
from planner_service.dip.network import DipNetwork, parameter_count

TINY = preset("tiny")
CONFIGS = {
    "small, shallow": preset("small").model_copy(update={"layers": 2}),
    "full, shallow": preset("full").model_copy(update={"layers": 2}),
    "tiny": TINY,
    "tiny, every condition": TINY.model_copy(update={"keyframes": True, "velocity": True}),
    "tiny, norms after": TINY.model_copy(update={"norm_first": False, "condition_every_frame": False}),
}


def network_of(config: DipConfig) -> DipNetwork:
    """Random weights everywhere, also where training begins with zeros."""
    torch.manual_seed(3)
    network = DipNetwork(config).eval().requires_grad_(False)
    for name, parameter in network.named_parameters():
        if parameter.ndim == 1 or not parameter.any():
            torch.nn.init.normal_(parameter, 1.0 if "norm" in name and "weight" in name else 0.0, 0.1)
    return network


def asked(config: DipConfig, batch: int, tokens: int) -> Conditions:
    """Random conditions; the first request has every text token, the last none, those between some."""
    torch.manual_seed(4)
    mask = torch.arange(tokens)[None] < torch.linspace(tokens, 0, batch).round()[:, None]
    return Conditions(
        prefix=torch.randn(batch, config.prefix_frames, config.features),
        targets=torch.randn(batch, TARGET_NUMBERS),
        text=torch.randn(batch, tokens, config.text_dim),
        text_mask=mask,
        keyframes=torch.randn(batch, config.plan_frames, KEYFRAME_NUMBERS) if config.keyframes else None,
        velocity=torch.randn(batch, VELOCITY_NUMBERS) if config.velocity else None,
    )


def plainly(network: DipNetwork, given: Conditions, free: Tensor, noisy: Tensor, number: int) -> Tensor:
    """The rows of `FoldedDip.denoise` by the network that is trained, one row at a time."""
    rows = [(request, given.text_mask[request]) for request in range(len(noisy))]
    rows += [(int(request), torch.zeros_like(given.text_mask[0])) for request in free]
    out = []
    for request, mask in rows:
        one = slice(request, request + 1)
        out.append(
            network(
                noisy[one],
                torch.tensor([number]),
                given.prefix[one],
                given.targets[one],
                given.text[one],
                mask[None],
                None if given.keyframes is None else given.keyframes[one],
                None if given.velocity is None else given.velocity[one],
            )
        )
    return torch.cat(out)


@pytest.mark.parametrize("name", CONFIGS)
@pytest.mark.parametrize(("batch", "tokens", "free"), [(1, 12, [0]), (1, 7, []), (3, 9, [0, 2])])
def test_outputs_are_the_plain_networks(name: str, batch: int, tokens: int, free: list[int]) -> None:
    config = CONFIGS[name]
    network = network_of(config)
    given, also_free = asked(config, batch, tokens), torch.tensor(free, dtype=torch.int64)
    numbers = (9, 5, 0)
    folded = FoldedDip(network, TorchBlocks(network))
    state = folded.begin(given, also_free, numbers)
    for position, number in enumerate(numbers):
        noisy = torch.randn(batch, config.plan_frames, config.features)
        found = folded.denoise(state, noisy, position)
        wanted = plainly(network, given, also_free, noisy, number)
        assert wanted.std() > 0.1
        torch.testing.assert_close(found, wanted, atol=1e-4, rtol=0)


def test_the_papers_size_has_the_papers_number_of_parameters() -> None:
    assert abs(parameter_count(DipNetwork(preset("full"))) - 26.7e6) < 0.2e6
