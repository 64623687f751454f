"""`python -m tracker_service.training.main`: train the tracker's policy on a corpus."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import numpy.typing as npt
import torch
import typer

from shared.console import errors_for_people
from shared.data.corpus import Corpus
from tracker_service.simulation.character_spec import HUMAN
from tracker_service.simulation.character_spec import character as character_named
from tracker_service.simulation.humanoid import Humanoid, humanoid
from tracker_service.training.dataset import (
    LARGEST_CHANGE_RAD,
    MotionInput,
    ReferenceSet,
    concatenated,
    hinges_jump,
    load_bank,
    prepare_cached,
    seat_in,
    sized,
)
from tracker_service.training.env_settings import EnvSettings
from tracker_service.training.ppo import PpoSettings
from tracker_service.training.seats import wide_fits
from tracker_service.training.trainer import Trainer

LEAST_TICKS = 30
HELDOUT_PIECE = 12


def motions(corpus: Corpus, split: str, mirrored: bool = True) -> list[MotionInput]:
    """Clips of a split long enough to follow."""
    return [
        MotionInput(clip.name, clip.behaviour, max(clip.weight, 1e-9), corpus.positions(i), seat_in(clip))
        for i, clip in enumerate(corpus.clips)
        if clip.split == split and clip.frames >= LEAST_TICKS and (mirrored or not clip.mirrored)
    ]


def references(
    corpus_dir: Path, split: str, cache: Path, say: Callable[[str], None], human: Humanoid | None = None,
    jobs: int = 1,
) -> ReferenceSet:  # fmt: skip
    """Prepared references of a split; held-out clips are not judged twice by their mirror images."""

    def progress(what: str, share: float) -> None:
        say(f"{what}: {100 * share:.0f} %")

    corpus = Corpus.load(corpus_dir)
    clips = motions(corpus, split, mirrored=split == "train")
    human = human or humanoid(HUMAN)
    return prepare_cached(human, [sized(clip, human) for clip in clips], cache, progress, jobs)


def training_sets(
    human: Humanoid, corpus: Path, cache: Path, focus: dict[str, float], banks: dict[Path, float],
    say: Callable[[str], None], jobs: int = 1,
) -> tuple[ReferenceSet, ReferenceSet]:  # fmt: skip
    """What is trained on and what is held out, prepared by `jobs` processes; arguments as for `train`, banks with
    their shares."""
    train_set = references(corpus, "train", cache, say, human, jobs)
    heldout_set = references(corpus, "heldout", cache, say, human, jobs)
    jumping = hinges_jump(train_set)
    say(f"{int(jumping.sum())} clips left out: a hinge jumps by more than {LARGEST_CHANGE_RAD:g} rad in a tick")
    train_set = replace(train_set, weight=train_set.weight * ~jumping)
    train_set = replace(train_set, seat=with_sofas(train_set, human))
    factors = np.array([focus.get(str(name), 1.0) for name in train_set.behaviours])
    train_set = replace(train_set, weight=train_set.weight * factors)
    later = sum(banks.values())
    for bank, share in banks.items():
        later -= share
        pieces = [sized(piece, human) for piece in load_bank(bank)]
        kept, heldout = ([p for i, p in enumerate(pieces) if (i % HELDOUT_PIECE == 0) is out] for out in (False, True))
        # What comes later takes its part of this one too: in the end each has its share, the corpus what they leave.
        train_set = concatenated(train_set, prepare_cached(human, kept, cache, jobs=jobs), share / (1.0 - later))
        heldout_set = concatenated(heldout_set, prepare_cached(human, heldout, cache), 0.5)
    say(f"{len(train_set)} clips, {len(train_set.qpos) / 1800:.1f} min to train on; {len(heldout_set)} held out")
    return train_set, heldout_set


def with_sofas(references: ReferenceSet, human: Humanoid) -> npt.NDArray[np.float64]:
    """(C, 5) seats, every second of those that a sofa could stand in for being one."""
    feet = human.skeleton.indices("left_ankle", "right_ankle", "left_foot", "right_foot")
    seats = references.seat.copy()
    fit = [
        clip for clip in np.flatnonzero(seats[:, 2] > 0)
        if wide_fits(references.pos_w_m[references.start[clip] :][: references.length[clip]], seats[clip], feet)
    ]  # fmt: skip
    seats[fit[::2], 4] = 1.0
    return seats


def train(
    corpus: Path, out: Path, until_samples: int = 50_000_000, threads: int = 1, envs: int = 320, seed: int = 0,
    init: Path | None = None, focus: dict[str, float] | None = None, bank: Path | None = None,
    bank_share: float = 0.5, kl_target: float | None = None, character: str = "human",
    say: Callable[[str], None] = print,
) -> None:  # fmt: skip
    """Train until `until_samples` or SIGTERM/SIGINT, resuming from `out`/checkpoint.pt when there is one.

    Args:
        corpus: folder made by `motionloop data build`.
        threads: of physics and of torch together, at different times.
        focus: factors on the sampling weight of behaviours, for those that matter most now.
        bank: folder of recorded plans to train on as well, with `bank_share` of the sampling; every twelfth piece is
            held out and judged as behaviour `plan`.
        kl_target: how far an update may go; None for the default. Less makes the weights less noisy in the end.
        init: checkpoint to start from where `out` has none (weights and normaliser only).
        character: of the registry; the corpus's motion is scaled to it.
    """
    torch.set_num_threads(threads)
    human = humanoid(character_named(character))
    banks = {} if bank is None else {bank: bank_share}
    train_set, heldout_set = training_sets(human, corpus, out / "cache", focus or {}, banks, say, threads)
    stop = False

    def ask_to_stop(signum: int, frame: object) -> None:
        nonlocal stop
        stop = True

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, ask_to_stop)
    ppo = PpoSettings() if kl_target is None else PpoSettings(kl_target=kl_target)
    trainer = Trainer(human, train_set, heldout_set, out, EnvSettings(envs=envs, threads=threads), ppo, seed)
    checkpoint = out / "checkpoint.pt"
    if checkpoint.exists():
        trainer.load(checkpoint)
        say(f"resumed at {trainer.samples} samples")
    elif init is not None:
        trainer.load(init, weights_only=True)
        say(f"started from {init}")
    (out / "pid").write_text(f"{os.getpid()}\n", encoding="utf-8")
    trainer.train(until_samples, lambda: stop, say)
    say("stopped" if stop else "done")


app = typer.Typer(add_completion=False)


@app.command()
def main(
    corpus: Annotated[Path, typer.Option(help="folder made by `motionloop data build`")],
    out: Annotated[Path, typer.Option(help="folder for checkpoint and logs")],
    until_samples: int = 50_000_000,
    threads: int = 1,
    envs: int = 320,
    seed: int = 0,
    init: Annotated[Path | None, typer.Option(help="checkpoint to start from")] = None,
    focus: Annotated[str, typer.Option(help="sampling factors, e.g. walk=2,dance=0.5")] = "",
    bank: Annotated[Path | None, typer.Option(help="folder of plans made by `motionloop data bank`")] = None,
    bank_share: Annotated[float, typer.Option(min=0.01, max=0.99, help="of the sampling")] = 0.5,
    kl_target: Annotated[float | None, typer.Option(min=1e-4, help="size of an update")] = None,
    character: Annotated[str, typer.Option(help="who is trained: human, child or heavy")] = "human",
) -> None:
    """Train the tracker with PPO; stops cleanly on SIGTERM and resumes where it stopped."""

    def say(line: str) -> None:
        typer.echo(line)

    factors = {name: float(value) for name, value in (part.split("=") for part in focus.split(",") if part)}
    train(corpus, out, until_samples, threads, envs, seed, init, factors, bank, bank_share, kl_target, character, say)


if __name__ == "__main__":
    with errors_for_people():
        app()
