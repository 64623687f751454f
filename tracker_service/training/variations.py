"""Runs played backwards and runs in tight curves, a bank for the tracker to practise.

    python -m tracker_service.training.variations --corpus DIR --out BANK      # then train with --bank BANK=.1

Nobody runs backwards in the recordings, and curves are as tight as the rooms they were recorded in; what is recorded
elsewhere does both. A run backwards in time is one that a body can perform: gravity knows no direction of time, only
what yields does (feet that land give way a little).
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from shared.console import errors_for_people
from shared.data.corpus import Corpus
from shared.data.make_gaits import curve
from shared.motion.body import Array, velocity
from shared.motion.resampling import resample
from shared.protocol.rates import CORPUS_FPS as FPS

ACTIONS = ("run", "run_curve", "run_circle", "walk_fast", "run_start", "run_stop")
BACKWARDS_MPS, CURVED_MPS = 3.0, 3.6
"""Faster ones are left out."""
PACES = (1.0, 0.8)
"""Of what is played backwards: as it was, and slower."""
SIDEWAYS_MPS2 = (4.0, 9.0)
LEAST_FRAMES = 45


def backwards(positions_w_m: Array, pace: float) -> Array:
    """(T', 22, 3) at 30 fps: a clip (T, 22, 3) from its end to its beginning, at `pace` times its speed."""
    return np.asarray(resample(positions_w_m[::-1], FPS, FPS / pace), dtype=np.float64)


def speed_mps(positions_w_m: Array) -> float:
    """95th percentile of the pelvis' speed over the floor, smoothed by a third of a second."""
    path = np.linalg.norm(velocity(positions_w_m[:, 0, :2], FPS), axis=-1)
    return float(np.percentile(np.convolve(path, np.full(10, 0.1), "valid"), 95))


def variations(corpus: Corpus, seed: int) -> Iterator[tuple[str, str, Array]]:
    """Name, behaviour and positions (T, 22, 3) of what is made of each training clip of ACTIONS."""
    rng = np.random.default_rng(seed)
    for i in corpus.select(split="train"):
        clip = corpus.clips[i]
        if clip.action not in ACTIONS or clip.frames < LEAST_FRAMES:
            continue
        name, positions = clip.name.replace("/", "_"), np.asarray(corpus.positions(i), dtype=np.float64)
        speed = speed_mps(positions)
        if speed <= BACKWARDS_MPS:
            yield f"{name}_backwards", "step_back", backwards(positions, float(rng.choice(PACES)))
        if clip.action == "run" and speed <= CURVED_MPS:
            rate = rng.choice((-1.0, 1.0)) * rng.uniform(*SIDEWAYS_MPS2) / speed
            yield f"{name}_curved", "run", curve(positions, float(rate))


def main(
    corpus: Annotated[Path, typer.Option(help="folder of a corpus")],
    out: Annotated[Path, typer.Option(help="folder for the bank")],
    seed: Annotated[int, typer.Option(min=0)] = 0,
) -> None:
    """Write the bank, an .npz a piece."""
    with errors_for_people():
        loaded = Corpus.load(corpus)
    out.mkdir(parents=True, exist_ok=True)
    count = {"step_back": 0, "run": 0}
    for name, behaviour, positions in variations(loaded, seed):
        np.savez_compressed(out / f"{name}.npz", positions_w_m=positions.astype(np.float32), behaviour=behaviour)
        count[behaviour] += 1
    typer.echo(json.dumps(count))


if __name__ == "__main__":
    typer.run(main)
