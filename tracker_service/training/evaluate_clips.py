"""`motionloop eval tracker`: how well the shipped policy follows clips, recorded or held out of a corpus (DESIGN 8).

`--clips DIR` takes motion files (BVH, ASF + AMC, SMPL npz; any reasonable skeleton is retargeted), `--corpus DIR` the
held-out clips of a corpus.
"""

from __future__ import annotations

import json
import platform
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
import typer

from shared.console import errors_for_people
from shared.data.corpus import Corpus
from shared.data.importer import load_clip
from shared.errors import InvalidInputError
from shared.motion.io.files import SUFFIXES
from shared.motion.resampling import resample
from tracker_service.policy.learned import WEIGHTS, LearnedTracker
from tracker_service.simulation.character_spec import HUMAN
from tracker_service.simulation.humanoid import humanoid
from tracker_service.simulation.reference import TICK_HZ
from tracker_service.training.dataset import MotionInput, prepare
from tracker_service.training.env import EnvSettings
from tracker_service.training.evaluate import evaluate

F32 = npt.NDArray[np.float32]
LEAST_TICKS = 30


def motions_of_files(folder: Path) -> tuple[list[MotionInput], dict[str, str]]:
    """Clips of a file or of all motion files below a folder, at 30 Hz, and why others were left out.

    The behaviour is the name of the folder a file lies in.
    """
    files = [folder] if folder.is_file() else sorted(p for p in folder.rglob("*") if p.suffix.lower() in SUFFIXES)
    if not files:
        raise InvalidInputError(f"no motion files at {folder}", field="clips", allowed=", ".join(SUFFIXES))
    motions: list[MotionInput] = []
    left_out: dict[str, str] = {}
    for file in files:
        try:
            clip, _ = load_clip(file)
        except InvalidInputError as error:
            left_out[file.name] = error.message
            continue
        positions = resample(clip.positions_w_m, clip.fps, TICK_HZ)
        if len(positions) < LEAST_TICKS:
            left_out[file.name] = f"shorter than {LEAST_TICKS / TICK_HZ:g} s"
            continue
        motions.append(MotionInput(file.stem, file.parent.name, 1.0, positions))
    if not motions:
        why = "; ".join(f"{name}: {reason}" for name, reason in list(left_out.items())[:3])
        allowed = ", ".join(SUFFIXES)
        raise InvalidInputError(f"no clip at {folder} can be followed: {why}", field="clips", allowed=allowed)
    return motions, left_out


def motions_of_corpus(folder: Path, split: str) -> list[MotionInput]:
    """Clips of one split of a corpus; mirror images are not judged a second time."""
    corpus = Corpus.load(folder)
    return [
        MotionInput(clip.name, clip.behaviour, 1.0, corpus.positions(i))
        for i, clip in enumerate(corpus.clips)
        if clip.split == split and clip.frames >= LEAST_TICKS and not clip.mirrored
    ]


def evaluate_weights(motions: list[MotionInput], weights: Path | None = WEIGHTS) -> dict[str, Any]:
    """Fields of DESIGN 8 for a policy file, or for the `pd` baseline where `weights` is None."""
    human = humanoid(HUMAN)
    references = prepare(human, motions)
    hinges = len(human.hinges)

    def rest(observation: F32) -> F32:
        return np.zeros((len(observation), hinges), np.float32)

    policy = rest if weights is None else LearnedTracker(human.damping / human.stiffness, weights).network
    return evaluate(EnvSettings(), references, human, policy)


app = typer.Typer(add_completion=False)


@app.command()
def main(
    clips: Annotated[Path | None, typer.Option(help="file or folder of motion files")] = None,
    corpus: Annotated[Path | None, typer.Option(help="corpus whose held-out clips are followed")] = None,
    weights: Annotated[Path, typer.Option(help="policy to judge")] = WEIGHTS,
    tracker: Annotated[str, typer.Option(help="ppo, or pd for the baseline")] = "ppo",
    json_file: Annotated[Path | None, typer.Option("--json", help="where to write the result")] = None,
    seed: Annotated[int, typer.Option(help="noted in the result; the evaluation has no randomness")] = 0,
) -> None:
    """Follow every clip once and report success, errors and falls by behaviour."""
    if (clips is None) == (corpus is None):
        raise typer.BadParameter("give either --clips or --corpus")
    if tracker not in ("ppo", "pd"):
        raise typer.BadParameter(f"unknown tracker {tracker!r}; known: ppo, pd")
    left_out: dict[str, str] = {}
    if clips is not None:
        motions, left_out = motions_of_files(clips)
    else:
        assert corpus is not None
        motions = motions_of_corpus(corpus, "heldout")
    result = evaluate_weights(motions, weights if tracker == "ppo" else None)
    result |= {"left_out": left_out, "tracker": tracker, "weights": str(weights), "seed": seed}
    result["machine"] = f"{platform.machine()} {platform.system()} {platform.release()}"
    if json_file is not None:
        json_file.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    for name, row in sorted(result["by_behaviour"].items()):
        typer.echo(f"{name:14} {row['success']:.2f} of {row['clips']:3}  {row['mpjpe_mm']:.0f} mm")
    for name, reason in left_out.items():
        typer.echo(f"left out {name}: {reason}")
    typer.echo(
        f"success {result['success']:.3f} of {result['clips']}, {result['mpjpe_mm']:.0f} mm, "
        f"{result['falls_per_min']:.2f} falls a minute"
    )


if __name__ == "__main__":
    with errors_for_people():
        app()
