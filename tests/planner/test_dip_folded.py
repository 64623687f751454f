"""DiP for use gives what the network that was trained gives: every size, every condition, alone and in a batch."""

from __future__ import annotations

import sys
from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from planner_service.dip.blocks import Blocks, TorchBlocks
from planner_service.dip.conditions import KEYFRAME_NUMBERS, TARGET_NUMBERS, VELOCITY_NUMBERS
from planner_service.dip.config import DipConfig, preset
from planner_service.dip.folded import Conditions, FoldedDip
from planner_service.dip.network import DipNetwork, parameter_count
from planner_service.dip.runtime import choose_blocks
from shared.errors import UnavailableError

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


def openvino_blocks(network: DipNetwork, bf16: bool = False) -> Blocks:
    pytest.importorskip("openvino", reason="the extra `fast` is not installed")
    from planner_service.dip.openvino_blocks import OpenVinoBlocks

    return OpenVinoBlocks(network, bf16)


RUNTIMES: dict[str, Callable[[DipNetwork], Blocks]] = {"torch": TorchBlocks, "openvino": openvino_blocks}


@pytest.mark.parametrize("runtime", RUNTIMES)
@pytest.mark.parametrize("name", CONFIGS)
@pytest.mark.parametrize(("batch", "tokens", "free"), [(1, 12, [0]), (1, 7, []), (3, 9, [0, 2])])
def test_outputs_are_the_plain_networks(name: str, runtime: str, batch: int, tokens: int, free: list[int]) -> None:
    config = CONFIGS[name]
    network = network_of(config)
    given, also_free = asked(config, batch, tokens), torch.tensor(free, dtype=torch.int64)
    blocks = RUNTIMES[runtime](network)
    folded, numbers = FoldedDip(network, blocks, blocks), (9, 5, 0)
    state = folded.begin(given, also_free, numbers)
    for position, number in enumerate(numbers):
        noisy = torch.randn(batch, config.plan_frames, config.features)
        found = folded.denoise(state, noisy, position)
        wanted = plainly(network, given, also_free, noisy, number)
        assert wanted.std() > 0.1
        torch.testing.assert_close(found, wanted, atol=1e-4, rtol=0)


@pytest.mark.parametrize("runtime", RUNTIMES)
def test_the_same_is_the_same_bit_for_bit_also_from_a_fresh_start(runtime: str) -> None:
    network = network_of(TINY)
    given, free = asked(TINY, 2, 9), torch.tensor([0])
    noisy = torch.randn(2, TINY.plan_frames, TINY.features)

    def once(blocks: Blocks) -> Tensor:
        folded = FoldedDip(network, blocks, blocks)
        return folded.denoise(folded.begin(given, free, [0, 5]), noisy, 1)

    first = RUNTIMES[runtime](network)
    found = once(first)
    assert torch.equal(once(first), found)
    assert torch.equal(once(RUNTIMES[runtime](network)), found)


def test_the_last_step_is_the_exact_one() -> None:
    network = network_of(TINY)
    exact = TorchBlocks(network)
    folded = FoldedDip(network, TorchBlocks(network, bf16=True), exact)
    given, free = asked(TINY, 1, 9), torch.tensor([0])
    noisy = torch.randn(1, TINY.plan_frames, TINY.features)
    errors = []
    for number in (0, 5):
        state = folded.begin(given, free, [0, 5])
        errors.append(
            float(
                (
                    folded.denoise(state, noisy, [0, 5].index(number)) - plainly(network, given, free, noisy, number)
                ).std()
            )
        )
    assert errors[0] < 1e-5 < 1e-4 < errors[1] < 0.05


def test_without_the_extra_torch_is_used_unless_openvino_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "openvino", None)
    for name in ("openvino_blocks", "openvino_core"):
        monkeypatch.delitem(sys.modules, f"planner_service.dip.{name}", raising=False)
    network = network_of(TINY)
    assert choose_blocks(network, "auto", bf16=False).name == "torch float32"
    with pytest.raises(UnavailableError) as caught:
        choose_blocks(network, "openvino")
    assert caught.value.field == "runtime"


def test_the_papers_size_has_the_papers_number_of_parameters() -> None:
    assert abs(parameter_count(DipNetwork(preset("full"))) - 26.7e6) < 0.2e6
