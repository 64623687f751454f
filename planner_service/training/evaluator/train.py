"""Train the evaluator: `python -m planner_service.training.evaluator.train --corpus DIR`.

Minutes on one CPU core or a GPU. It is trained once, shipped and then left alone: numbers made with two evaluators do
not compare.
"""

from __future__ import annotations

import json
import math
import sys
import time
from hashlib import sha256
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from planner_service.dip.features_torch import Normalizer
from planner_service.dip.network import parameter_count
from planner_service.text.encoder import TextEncoder
from planner_service.text.pretrained import minilm
from planner_service.training.dataset import Material, TextBank, load_material
from planner_service.training.evaluator.meanings import Meanings, meanings_of
from planner_service.training.evaluator.network import EvaluatorConfig, EvaluatorNetwork, contrastive_loss
from planner_service.training.evaluator.pairs import LEAST, PairSampler, fixed_pairs
from planner_service.training.evaluator.scores import DRAWS, draw_pools, other_meaning, r_precision
from planner_service.training.evaluator.weights import SHIPPED, Evaluator, save_evaluator
from planner_service.training.export import commit
from shared.console import check_output_file, errors_for_people
from shared.data.corpus import Corpus
from shared.processor import bf16_pays

PREFIX = 20
NOISE = 0.05
"""Standard deviation, in units of the features' spread, of the noise that some motions get: plans are no recordings."""
MOST_SCALE = math.log(50.0)
WARM_UP = 100
MOST_PAIRS = 500
"""Of a split are asked how well they find their sentences; more would only take longer."""


def fit(
    network: EvaluatorNetwork,
    normalizer: Normalizer,
    material: Material,
    meanings: Meanings,
    encoder: TextEncoder,
    steps: int,
    batch: int,
    learning_rate: float,
    seed: int,
    device: str = "cpu",
    progress: Progress | None = None,
) -> list[float]:
    """Train in place; the loss of every step."""
    torch.manual_seed(seed)
    network.to(device).train()
    mean, std = normalizer.mean.to(device), normalizer.std.to(device)
    said = torch.from_numpy(meanings.said)
    bf16 = device != "cpu" or bf16_pays()
    bank = TextBank(encoder, material.sentences)
    sampler = PairSampler(material, meanings, seed)
    optimizer = torch.optim.AdamW(network.parameters(), lr=learning_rate, weight_decay=0.05)
    task = None if progress is None else progress.add_task("training", total=steps)
    losses = []
    for step in range(steps):
        share = min(1.0, (step + 1) / WARM_UP) * 0.5 * (1 + math.cos(math.pi * step / steps))
        optimizer.param_groups[0]["lr"] = learning_rate * share
        pairs = sampler.draw(batch)
        features, length = sampler.features(pairs)
        tokens, mask = bank.rows(torch.from_numpy(pairs.sentence), torch.ones(batch, dtype=torch.bool))
        fits = said[torch.from_numpy(pairs.sentence)][:, torch.from_numpy(pairs.meaning)].T
        normal = (features.to(device) - mean) / std
        normal = normal + NOISE * torch.rand(batch, 1, 1, device=device) * torch.randn_like(normal)
        with torch.autocast(torch.device(device).type, torch.bfloat16, enabled=bf16):
            motion = network.motion(normal, length.to(device))
            sentence = network.sentence(tokens.to(device), mask.to(device))
        scale = network.log_scale.clamp(max=MOST_SCALE).exp()
        loss = contrastive_loss(motion.float(), sentence.float(), fits.to(device), scale)
        optimizer.zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
        losses.append(float(loss.detach()))
        if progress is not None and task is not None:
            progress.update(task, advance=1, description=f"loss {np.mean(losses[-50:]):.3f}")
    network.to("cpu").eval()
    return losses


def retrieval(evaluator: Evaluator, material: Material, meanings: Meanings, seed: int) -> dict[str, object]:
    """How well the recorded motion of a material finds its own sentences; chance beside it."""
    pairs = fixed_pairs(material, meanings, PREFIX, seed)
    if len(pairs.clip) > MOST_PAIRS:
        pairs = pairs.some(np.linspace(0, len(pairs.clip) - 1, MOST_PAIRS).round().astype(np.int64))
    motion = evaluator.embed_motions(pairs.motions(material))
    sentence = evaluator.embed_texts([material.sentences[row] for row in pairs.sentence])
    pools = draw_pools(other_meaning(pairs.meaning), pairs.meaning, DRAWS, np.random.default_rng(seed))
    width = pools.shape[-1] + 1
    return {
        "motions": len(pairs.clip),
        "meanings": len(np.unique(pairs.meaning)),
        "pool": width,
        "r_precision": [round(float(x), 4) for x in r_precision(motion, sentence, sentence, pools)],
        "chance": [round(k / width, 4) for k in (1, 2, 3)],
    }


def spread_of(material: Material, meanings: Meanings, seed: int, batches: int = 16) -> Normalizer:
    """Mean and deviation of the features as training sees them; the deviation has a floor, so nothing explodes."""
    sampler = PairSampler(material, meanings, seed)
    rows = []
    for _ in range(batches):
        pairs = sampler.draw(128)
        rows += [material.features[b : b + LEAST] for b in pairs.begin]
    frames = torch.from_numpy(np.concatenate(rows))
    return Normalizer(frames.mean(0), frames.std(0).clamp_min(0.05))


def train(
    corpus: Annotated[Path, typer.Option(help="folder of the corpus")],
    out: Annotated[Path, typer.Option(help="weights to write; the card goes beside them")] = SHIPPED,
    steps: Annotated[int, typer.Option(min=1)] = 1500,
    batch: Annotated[int, typer.Option(min=2)] = 128,
    learning_rate: Annotated[float, typer.Option(help="of AdamW, falling to nothing")] = 6e-4,
    device: Annotated[str, typer.Option(help="cpu or cuda")] = "cpu",
    threads: Annotated[int, typer.Option(min=1)] = 1,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    cache: Annotated[Path | None, typer.Option(help="folder to keep features in; a planner training's serves")] = None,
) -> None:
    """Train text and motion encoders on a corpus' training split and say how held-out motion finds its sentences."""
    torch.set_num_threads(threads)
    check_output_file(out)
    began = time.monotonic()
    loaded, encoder = Corpus.load(corpus), minilm()
    material = load_material(loaded, "train", PREFIX + LEAST, cache)
    heldout = load_material(loaded, "heldout", PREFIX + LEAST, cache)
    meanings = meanings_of(material)
    normalizer = spread_of(material, meanings, seed)
    torch.manual_seed(seed)
    network = EvaluatorNetwork(EvaluatorConfig(text_encoder=encoder.spec.name, text_dim=encoder.spec.dim))
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns) as progress:
        losses = fit(
            network, normalizer, material, meanings, encoder, steps, batch, learning_rate, seed, device, progress
        )
    trained = Evaluator(network, normalizer, encoder, "")
    card: dict[str, object] = {
        "name": "evaluator",
        "licence": "Apache-2.0",
        "config": network.config.model_dump(),
        "parameters": parameter_count(network),
        "command": " ".join(sys.argv),
        "commit": commit(),
        "data_manifest_sha256": sha256((corpus / "manifest.json").read_bytes()).hexdigest(),
        "clips": len(material.length),
        "steps": steps,
        "batch": batch,
        "seed": seed,
        "minutes": round((time.monotonic() - began) / 60, 1),
        "loss": round(float(np.mean(losses[-50:])), 4),
        "train": retrieval(trained, material, meanings, seed),
        "heldout": retrieval(trained, heldout, meanings_of(heldout), seed),
    }
    save_evaluator(out, network.requires_grad_(False), normalizer, card)
    print(json.dumps(card, indent=1))


if __name__ == "__main__":
    with errors_for_people():
        typer.run(train)
