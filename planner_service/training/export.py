"""Ship the averaged weights of a checkpoint: `python -m planner_service.training.export --checkpoint FILE`."""

from __future__ import annotations

import json
import subprocess
from hashlib import sha256
from pathlib import Path
from typing import Annotated

import typer

from planner_service.dip.config import DipConfig
from planner_service.dip.network import DipNetwork, parameter_count
from planner_service.dip.weights import SHIPPED, save_weights
from planner_service.training.trainer import checkpoint_normalizer, read_checkpoint


def export(
    checkpoint: Annotated[Path, typer.Option(help="last.pt of a training")],
    out: Annotated[Path, typer.Option(help="weights to write, .safetensors; the card goes beside it")] = SHIPPED,
    corpus: Annotated[Path | None, typer.Option(help="corpus trained on, for the hash of its manifest")] = None,
    metrics: Annotated[Path | None, typer.Option(help="JSON of an evaluation, for the card")] = None,
) -> None:
    """Write fp16 weights and their card."""
    content = read_checkpoint(checkpoint)
    network = DipNetwork(DipConfig.model_validate_json(content["config"]))
    network.load_state_dict(content["average"])
    command = checkpoint.with_name("command.txt")
    manifest = None if corpus is None else sha256((corpus / "manifest.json").read_bytes()).hexdigest()
    card: dict[str, object] = {
        "name": "dip",
        "licence": "Apache-2.0",
        "config": json.loads(content["config"]),
        "parameters": parameter_count(network),
        "training": json.loads(content["settings"]),
        "command": command.read_text(encoding="utf-8").strip() if command.is_file() else None,
        "commit": commit(),
        "data_manifest_sha256": manifest,
        "steps": content["step"],
        "hours": round(content["hours"], 3),
        "metrics": None if metrics is None else json.loads(metrics.read_text(encoding="utf-8")),
    }
    digest = save_weights(out, network, checkpoint_normalizer(content), card)
    print(f"{out}: step {content['step']}, {out.stat().st_size / 2**20:.1f} MiB, sha256 {digest}")


def commit() -> str | None:
    """Commit of the checkout, if there is one."""
    try:
        here = Path(__file__).parent
        done = subprocess.run(["git", "rev-parse", "HEAD"], cwd=here, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout.strip()


if __name__ == "__main__":
    typer.run(export)
