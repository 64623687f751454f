"""Train DiP: `python -m planner_service.training.main --corpus DIR --out DIR`.

Run again with the same --out to continue exactly where it stopped; SIGTERM stops it cleanly after the present step.
"""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path
from types import FrameType
from typing import Annotated

import torch
import typer

from planner_service.dip.config import DipConfig, preset
from planner_service.dip.features_torch import Normalizer
from planner_service.dip.network import DipNetwork, parameter_count, whiten_text, with_conditions
from planner_service.dip.weights import load_weights
from planner_service.text.pretrained import minilm
from planner_service.training.dataset import (
    Material,
    TextBank,
    WindowSampler,
    emphasized,
    feature_statistics,
    load_material,
)
from planner_service.training.trainer import Trainer, TrainSettings, checkpoint_normalizer, read_checkpoint
from shared.console import errors_for_people
from shared.data.corpus import Corpus
from shared.errors import InvalidInputError
from shared.processor import bf16_pays


def train(
    corpus: Annotated[Path, typer.Option(help="folder of the corpus")],
    out: Annotated[Path, typer.Option(help="folder for checkpoints and logs; an existing one is continued")],
    size: Annotated[str, typer.Option(help="tiny, small or full")] = "small",
    steps: Annotated[int, typer.Option(help="train until this step", min=1)] = 200_000,
    batch: Annotated[int, typer.Option(help="windows a step", min=1)] = 64,
    learning_rate: Annotated[float, typer.Option(help="of AdamW")] = 4e-4,
    decay_until: Annotated[int | None, typer.Option(help="step by which the rate has fallen to a twentieth")] = None,
    threads: Annotated[int, typer.Option(help="CPU threads", min=1)] = 1,
    device: Annotated[str, typer.Option(help="cpu or cuda")] = "cpu",
    workers: Annotated[int, typer.Option(help="processes that draw windows; 0: the training itself", min=0)] = 0,
    bf16: Annotated[bool | None, typer.Option(help="bfloat16 autocast; default: where the device has it")] = None,
    ema_decay: Annotated[float, typer.Option(help="of the weights' average", min=0, max=1)] = 0.9999,
    seed: Annotated[int, typer.Option(help="of windows, noise and dropout", min=0)] = 0,
    save_every: Annotated[int, typer.Option(help="steps between checkpoints", min=1)] = 250,
    emphasis: Annotated[str, typer.Option(help="draw these more often, e.g. wave=2,action:walk=1.5")] = "",
    init: Annotated[Path | None, typer.Option(help="warm start from these weights (safetensors)")] = None,
    conditions: Annotated[str, typer.Option(help="also learn keyframes, velocity or both: keyframes,velocity")] = "",
    keyframe_weight: Annotated[float, typer.Option(help="of keyed joints' squared errors", min=0)] = 8.0,
    velocity_weight: Annotated[float, typer.Option(help="of the asked velocity's squared error", min=0)] = 2.0,
) -> None:
    """Train DiP on a corpus."""
    torch.set_num_threads(threads)
    checkpoint = out / "last.pt"
    content = read_checkpoint(checkpoint) if checkpoint.is_file() else None
    material = load_material(Corpus.load(corpus), "train", _frames(size), cache=out)
    material = emphasized(material, _factors(emphasis))
    texts = TextBank(minilm(), material.sentences)
    more = [name.strip() for name in conditions.split(",") if name.strip()]
    if content is not None:
        network = DipNetwork(DipConfig.model_validate_json(content["config"]))
        if with_conditions(network, more).config != network.config:
            raise InvalidInputError(
                f"the training in {out} goes on as it began; a new one can start from its weights (--init)",
                field="conditions",
                allowed=",".join(network.config.extra_conditions) or "none",
            )
        normalizer = checkpoint_normalizer(content)
    elif init is not None:
        loaded = load_weights(init)
        network, normalizer = with_conditions(loaded.network, more).requires_grad_(True), loaded.normalizer
    else:
        torch.manual_seed(seed)
        network = with_conditions(DipNetwork(preset(size)), more)
        if network.config.pooled_text:
            whiten_text(network, texts.pooled())
        normalizer = Normalizer(*feature_statistics(_sampler(material, network.config, 0)))
    settings = TrainSettings(
        batch=batch,
        learning_rate=learning_rate,
        decay_until=decay_until,
        bf16=(device != "cpu" or bf16_pays()) if bf16 is None else bf16,
        ema_decay=ema_decay,
        workers=workers,
        seed=seed,
        save_every=save_every,
        keyframe_weight=keyframe_weight,
        velocity_weight=velocity_weight,
    )
    sampler = _sampler(material, network.config, seed)
    trainer = Trainer(network, normalizer, sampler, texts, settings, out, device)
    if content is not None:
        trainer.restore(content)
    (out / "command.txt").write_text(" ".join(sys.argv) + "\n", encoding="utf-8")
    print(
        f"DiP {size}: {parameter_count(network):,} parameters; {len(material.length)} clips, "
        f"{len(material.features) / 20 / 60:.1f} min, {len(material.sentences)} sentences; pid {os.getpid()}; "
        f"from step {trainer.state.step}",
        flush=True,
    )
    stopping = False

    def ask_to_stop(number: int, frame: FrameType | None) -> None:
        nonlocal stopping
        stopping = True

    signal.signal(signal.SIGTERM, ask_to_stop)
    signal.signal(signal.SIGINT, ask_to_stop)
    trainer.run(steps, lambda: stopping, lambda line: print(line, flush=True))


def _factors(emphasis: str) -> dict[str, float]:
    """`wave=2,turn=1.5` as a mapping; raises InvalidInputError for anything else."""
    out = {}
    for part in filter(None, emphasis.split(",")):
        name, _, factor = part.partition("=")
        try:
            out[name.strip()] = float(factor)
        except ValueError:
            raise InvalidInputError(f"emphasis {part!r}", field="emphasis", allowed="BEHAVIOUR=FACTOR,...") from None
    return out


def _sampler(material: Material, config: DipConfig, seed: int) -> WindowSampler:
    return WindowSampler(material, config.prefix_frames, config.plan_frames, seed)


def _frames(size: str) -> int:
    config = preset(size)
    return config.prefix_frames + config.plan_frames


if __name__ == "__main__":
    with errors_for_people():
        typer.run(train)
