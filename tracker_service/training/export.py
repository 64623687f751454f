"""From a training checkpoint to the shipped weights: fp16 safetensors with a JSON card."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
import typer
from safetensors.numpy import save_file

from tracker_service.simulation.character_spec import HUMAN, Character
from tracker_service.simulation.character_spec import character as character_named
from tracker_service.training.env_settings import EnvSettings
from tracker_service.training.network import Normalizer


def export_weights(checkpoint: Path, out: Path, card: dict[str, Any], character: Character = HUMAN) -> Path:
    """Write the averaged actor and its normaliser; `card` adds facts for people (command, commit, metrics).

    `character` is whom it was trained with; it drives no other.

    Returns the path of the safetensors file; the card lies beside it as .json.
    """
    state = torch.load(checkpoint, weights_only=True)
    actor = state["averaged"]
    numbers = sorted({int(k.split(".")[0]) for k in actor})
    normalizer = state["normalizer"]
    tensors = {
        "mean": normalizer["mean"].numpy(),
        "std": np.sqrt(normalizer["var"].numpy() + np.float32(1e-4)),
    }
    for i, number in enumerate(numbers):
        tensors[f"w{i}"] = actor[f"{number}.weight"].numpy().astype(np.float16)
        tensors[f"b{i}"] = actor[f"{number}.bias"].numpy().astype(np.float16)
    out.parent.mkdir(parents=True, exist_ok=True)
    save_file(tensors, str(out))
    out.chmod(0o644)
    samples, _, seconds = state["counters"]
    facts = {
        "version": hashlib.sha256(out.read_bytes()).hexdigest()[:12],
        "skeleton": character.skeleton_id,
        "character": character.name,
        "layers": len(numbers),
        "action_scale_rad": EnvSettings().action_scale_rad,
        "observation_clip": Normalizer(1).clip,
        "samples": samples,
        "training_hours": round(seconds / 3600, 3),
        **card,
    }
    out.with_suffix(".json").write_text(json.dumps(facts, indent=2) + "\n", encoding="utf-8")
    return out


app = typer.Typer(add_completion=False)


@app.command()
def main(
    checkpoint: Path,
    out: Path,
    corpus: Annotated[Path | None, typer.Option(help="names the data in the card")] = None,
    command: Annotated[str, typer.Option(help="the training command")] = "",
    commit: str = "",
    character: Annotated[str, typer.Option(help="whom it was trained with")] = "human",
) -> None:
    """Export a checkpoint, with the last held-out evaluation of its log in the card."""
    card: dict[str, Any] = {"command": command, "commit": commit}
    log = checkpoint.parent / "log.jsonl"
    if log.exists():
        rows = [json.loads(line) for line in log.read_text(encoding="utf-8").splitlines()]
        judged = [row for row in rows if row["kind"] == "heldout"]
        if judged:
            card["metrics"] = judged[-1]
    if corpus is not None:
        card["data_manifest_sha256"] = hashlib.sha256((corpus / "manifest.json").read_bytes()).hexdigest()
    typer.echo(str(export_weights(checkpoint, out, card, character_named(character))))


if __name__ == "__main__":
    app()
