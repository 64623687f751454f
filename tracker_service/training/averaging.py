"""One actor from several of the same training: the weighted mean of their weights.

What was learnt in stages, each going on from the last, lies near enough together for it (Wortsman et al. 2022, "Model
soups"), and the mean keeps more of what each can do than the last one does.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from safetensors.numpy import load_file, save_file

from shared.console import errors_for_people
from shared.errors import InvalidInputError
from tracker_service.training.world.weights import training_file

app = typer.Typer(add_completion=False)


def averaged(parts: dict[Path, float], out: Path, facts: dict[str, Any]) -> Path:
    """Write the mean of shipped actors, and critic and model of the last of them beside it.

    Args:
        parts: files of `export_learner` with their shares. facts: for the card, which is that of the last file.

    Raises:
        InvalidInputError: shares that do not add up to 1, or actors of different shapes or of different sight.
    """
    if not parts or abs(sum(parts.values()) - 1.0) > 1e-6:
        raise InvalidInputError(f"shares {list(parts.values())}", field="parts", allowed="together 1")
    files = {path: load_file(path) for path in parts}
    first = next(iter(files.values()))
    for path, tensors in files.items():
        if {n: t.shape for n, t in tensors.items()} != {n: t.shape for n, t in first.items()}:
            raise InvalidInputError(f"{path} has other layers", field="parts", allowed="networks of one shape")
        if any(not np.array_equal(tensors[name], first[name]) for name in ("mean", "std")):
            raise InvalidInputError(f"{path} sees otherwise", field="parts", allowed="one normaliser: of one training")
    mean = {
        name: np.sum([share * files[path][name].astype(np.float64) for path, share in parts.items()], axis=0)
        for name in first
    }
    out.parent.mkdir(parents=True, exist_ok=True)
    last = list(parts)[-1]
    card = json.loads(last.with_suffix(".json").read_text(encoding="utf-8"))
    rest = training_file(last)
    save_file({name: values.astype(first[name].dtype) for name, values in mean.items()}, str(out))
    out.chmod(0o644)
    if rest.exists() and training_file(out) != rest:
        shutil.copyfile(rest, training_file(out))
    card |= {"version": hashlib.sha256(out.read_bytes()).hexdigest()[:12], **facts}
    out.with_suffix(".json").write_text(json.dumps(card, indent=2) + "\n", encoding="utf-8")
    return out


@app.command()
def main(
    out: Annotated[Path, typer.Argument(help="the mean's .safetensors")],
    part: Annotated[list[str], typer.Option(help="FILE=SHARE, the newest last")],
    card: Annotated[str, typer.Option(help="facts for the card, as JSON")] = "{}",
) -> None:
    """Average actors of one training."""
    shares = {Path(path): float(share) for path, _, share in (p.rpartition("=") for p in part)}
    typer.echo(str(averaged(shares, out, json.loads(card))))


if __name__ == "__main__":
    with errors_for_people():
        app()
