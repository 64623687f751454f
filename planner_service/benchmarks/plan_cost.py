"""`python -m planner_service.benchmarks.plan_cost`: CPU time of a plan, by size and by what runs the network.

`full_plain` is the paper's size written down plainly (`plain.PlainDip`): ten steps, two passes each, float32 in torch.
`full` is the same network as it would be used, `small` what ships. They take turns, so that what else the machine does
meets them all alike: the ratios are what counts.
"""

from __future__ import annotations

import json
import os
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
import typer

from planner_service.benchmarks.plain import PlainDip
from planner_service.dip.config import preset
from planner_service.dip.network import DipNetwork, parameter_count
from planner_service.dip.planner import DipPlanner, DipSettings
from planner_service.dip.weights import SHIPPED, DipWeights, load_weights
from planner_service.text.encoder import TextEncoder
from planner_service.text.pretrained import minilm
from shared.console import errors_for_people
from shared.plugins.conformance import sample_request
from shared.protocol.messages import PlanRequest

TEXT = "a person is walking."
"""Guided, so every step has two rows of the network: what costs most."""
BATCH = 8
BASE = "full_plain"
SWITCHES = ("ATEN_CPU_CAPABILITY", "ONEDNN_MAX_CPU_ISA", "DNNL_MAX_CPU_ISA", "MKL_ENABLE_INSTRUCTIONS")
"""Variables that keep libraries from a processor's widest instructions."""


def planners(small: DipWeights, full: DipWeights, encoder: TextEncoder, settings: DipSettings) -> dict[str, DipPlanner]:
    """The three that are compared."""
    every_step = settings.model_copy(update={"steps": full.network.config.steps})
    return {
        BASE: DipPlanner(full, encoder, every_step, dip=PlainDip(full.network)),
        "full": DipPlanner(full, encoder, every_step),
        "small": DipPlanner(small, encoder, settings),
    }


def paper_sized(small: DipWeights, seed: int) -> DipWeights:
    """The paper's size with random weights, which cost what trained ones do."""
    torch.manual_seed(seed)
    return DipWeights(DipNetwork(preset("full")).eval().requires_grad_(False), small.normalizer, "0" * 64)


def largest_difference_m(weights: DipWeights, encoder: TextEncoder, settings: DipSettings) -> float:
    """Between a plan of a network run plainly and as in use, both in float32, over all joints and frames."""
    exact = settings.model_copy(update={"bf16": False, "steps": weights.network.config.steps})
    plain = DipPlanner(weights, encoder, exact, dip=PlainDip(weights.network))
    used = DipPlanner(weights, encoder, exact)
    one, other = (each.plan([request(each)])[0].positions_w_m.astype(np.float64) for each in (plain, used))
    return float(np.abs(one - other).max())


def request(planner: DipPlanner) -> PlanRequest:
    """One from standing, with a text."""
    return sample_request(planner.spec, text=TEXT)


def measure(compared: dict[str, DipPlanner], repeats: int, batch: int = BATCH) -> dict[str, dict[str, float]]:
    """Medians over the repeats, in which the planners take turns, of CPU and wall milliseconds a plan."""
    taken: dict[str, dict[str, list[float]]] = {name: {} for name in compared}
    for planner in compared.values():  # texts encoded, kernels made
        planner.plan([request(planner)])
        planner.plan([request(planner)] * batch)
    for _ in range(repeats):
        for name, planner in compared.items():
            for size in (1, batch):
                requests = [request(planner)] * size
                cpu_ms, wall_ms = _timed(lambda: planner.plan(requests))  # noqa: B023 - called at once
                taken[name].setdefault(f"cpu_ms_per_plan_b{size}", []).append(cpu_ms / size)
                taken[name].setdefault(f"wall_ms_b{size}", []).append(wall_ms)
    return {name: {key: statistics.median(found) for key, found in own.items()} for name, own in taken.items()}


def _timed(action: Callable[[], object]) -> tuple[float, float]:
    cpu, wall = time.process_time(), time.perf_counter()
    action()
    return (time.process_time() - cpu) * 1e3, (time.perf_counter() - wall) * 1e3


def plan_cost(weights: Path, repeats: int, settings: DipSettings, seed: int) -> dict[str, Any]:
    """The table; ratios are to `full_plain` at the same batch."""
    small, encoder = load_weights(weights), minilm()
    full = paper_sized(small, seed)
    compared = planners(small, full, encoder, settings)
    found = measure(compared, repeats)
    sizes = {"small": small, "full": full, BASE: full}
    rows = []
    for name, planner in compared.items():
        own = found[name]
        ratios = {
            f"ratio_b{size}": own[f"cpu_ms_per_plan_b{size}"] / found[BASE][f"cpu_ms_per_plan_b{size}"]
            for size in (1, BATCH)
        }
        rows.append(
            {
                "name": name,
                "runs_in": planner.runs_in,
                "parameters": parameter_count(DipNetwork(sizes[name].network.config)),
                **{key: round(value, 2) for key, value in own.items()},
                **{key: round(value, 4) for key, value in ratios.items()},
                "frames_per_s": round(planner.spec.plan_frames / (own["wall_ms_b1"] / 1e3), 1),
            }
        )
    return {
        "variants": rows,
        "full_largest_difference_m": largest_difference_m(full, encoder, settings),
        "weights_sha256": small.sha256,
        "repeats": repeats,
        "threads": settings.threads,
        "torch_cpu_capability": torch.backends.cpu.get_cpu_capability(),
        "switched_off": {name: os.environ[name] for name in SWITCHES if name in os.environ},
    }


def main(
    weights: Annotated[Path, typer.Option(help="safetensors of `small`")] = SHIPPED,
    repeats: Annotated[int, typer.Option(min=1, help="rounds in which each takes its turn")] = 5,
    runtime: Annotated[str, typer.Option(help="auto, torch or openvino, for `full` and `small`")] = "auto",
    steps: Annotated[int | None, typer.Option(min=1, help="diffusion steps of `small`; default: as in use")] = None,
    threads: Annotated[int, typer.Option(min=1)] = 1,
    seed: Annotated[int, typer.Option(min=0)] = 1,
    json_file: Annotated[Path | None, typer.Option("--json", help="where to write the result")] = None,
) -> None:
    """What a plan costs beside the paper's network written down plainly."""
    torch.set_num_threads(threads)
    asked: dict[str, object] = {"runtime": runtime, "threads": threads} | ({} if steps is None else {"steps": steps})
    result = plan_cost(weights, repeats, DipSettings.model_validate(asked), seed)
    text = json.dumps(result, indent=1)
    if json_file is not None:
        json_file.write_text(text + "\n", encoding="utf-8")
    print(text)


if __name__ == "__main__":
    with errors_for_people():
        typer.run(main)
