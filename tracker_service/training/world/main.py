"""`python -m tracker_service.training.world.main`: train the tracker's policy through a model of its body."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import torch
import typer

from shared.console import errors_for_people
from shared.errors import InvalidInputError
from tracker_service.simulation.character_spec import character as character_named
from tracker_service.simulation.humanoid import humanoid
from tracker_service.training.env_settings import EnvSettings
from tracker_service.training.main import training_sets
from tracker_service.training.world.settings import WorldSettings
from tracker_service.training.world.trainer import WorldTrainer
from tracker_service.training.world.weights import export_learner, warm_start

app = typer.Typer(add_completion=False)


def train(
    corpus: Path, out: Path, until_samples: int, threads: int, envs: int, seed: int, init: Path | None,
    focus: dict[str, float], banks: dict[Path, float], settings: WorldSettings,
    device: str = "cpu", character: str = "human", until_minutes: float = float("inf"), processes: int = 1,
    say: Callable[[str], None] = print,
) -> WorldTrainer:  # fmt: skip
    """Train until `until_samples`, `until_minutes` or SIGTERM/SIGINT, resuming from `out`/checkpoint.pt if it is there.

    Args:
        corpus: folder made by `motionloop data build`.
        threads: of physics and torch, at different times; before, so many processes prepare the references.
        focus: factors on the sampling weight of behaviours. banks: folders of recorded plans or ways up, with their
            shares of the sampling.
        character: of the registry; the corpus's motion is scaled to it.
        init: shipped actor to start from where `out` has no checkpoint; critic and model beside it are taken too.
    """
    torch.set_num_threads(threads)
    human = humanoid(character_named(character))
    train_set, heldout_set = training_sets(human, corpus, out / "cache", focus, banks, say, threads)
    stop = False

    def ask_to_stop(signum: int, frame: object) -> None:
        nonlocal stop
        stop = True

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, ask_to_stop)
    env = EnvSettings(envs=envs, threads=threads, processes=processes, heights=True)
    trainer = WorldTrainer(human, train_set, heldout_set, out, env, settings, seed, device)
    say(f"bf16 {trainer.learner.bf16}, compiled {trainer.learner.compiled}")
    checkpoint = out / "checkpoint.pt"
    if checkpoint.exists():
        trainer.load(checkpoint, say)
        say(f"resumed at {trainer.samples} samples")
    elif init is not None:
        both = warm_start(trainer.learner, init)
        say(f"started from {init}" + ("" if both else "; critic and model start from nothing"))
        trainer.prepare(say, fresh_sight=False, fresh_model=not both)
    (out / "pid").write_text(f"{os.getpid()}\n", encoding="utf-8")
    limit = trainer.seconds + 60.0 * until_minutes
    trainer.train(until_samples, lambda: stop or trainer.seconds > limit, say)
    say("stopped" if stop else "done")
    return trainer


def factors(text: str) -> dict[str, float]:
    """Sampling factors from `walk=2,dance=0.5`."""
    return {name: float(value) for name, value in (part.split("=") for part in text.split(",") if part)}


def shares(banks: list[str]) -> dict[Path, float]:
    """Folders and their shares of the sampling from `FOLDER=SHARE`; a quarter where none is said.

    Raises:
        InvalidInputError: a share is no number between 0 and 1, or they leave nothing for the corpus.
    """
    out: dict[Path, float] = {}
    for bank in banks:
        folder, _, share = bank.partition("=")
        try:
            out[Path(folder)] = float(share or 0.25)
        except ValueError:
            raise InvalidInputError(f"bank {bank!r}", field="bank", allowed="FOLDER=SHARE") from None
    if any(s <= 0 for s in out.values()) or sum(out.values()) >= 1:
        raise InvalidInputError("shares of the banks", field="bank", allowed="above 0, together below 1")
    return out


@app.command()
def main(
    corpus: Annotated[Path, typer.Option(help="folder made by `motionloop data build`")],
    out: Annotated[Path, typer.Option(help="folder for checkpoint and logs")],
    until_samples: int = 50_000_000,
    until_minutes: Annotated[float, typer.Option(help="of training in this run")] = 1e9,
    threads: int = 1,
    processes: Annotated[int, typer.Option(help="of the environments, where there are many cores")] = 1,
    envs: int = 320,
    seed: int = 0,
    init: Annotated[Path | None, typer.Option(help="shipped actor to start from")] = None,
    focus: Annotated[str, typer.Option(help="sampling factors, e.g. walk=2,dance=0.5")] = "",
    bank: Annotated[list[str], typer.Option(help="FOLDER=SHARE: of `motionloop data bank` or ways up")] = [],  # noqa: B006
    settings: Annotated[str, typer.Option(help="numbers of WorldSettings as JSON")] = "{}",
    device: Annotated[str, typer.Option(help="cpu or cuda")] = "cpu",
    character: Annotated[str, typer.Option(help="who is trained: human, child or heavy")] = "human",
    export: Annotated[Path | None, typer.Option(help="write the weights there at the end")] = None,
    card: Annotated[str, typer.Option(help="facts for the exported card, as JSON")] = "{}",
) -> None:
    """Train the tracker through a world model; stops cleanly on SIGTERM and resumes where it stopped."""
    trainer = train(
        corpus, out, until_samples, threads, envs, seed, init, factors(focus), shares(bank),
        WorldSettings.model_validate_json(settings), device, character, until_minutes, processes,
        lambda line: typer.echo(line),
    )  # fmt: skip
    if export is not None:
        facts: dict[str, Any] = {"samples": trainer.samples, "training_hours": round(trainer.seconds / 3600, 3)}
        typer.echo(
            str(export_learner(trainer.learner, export, {**facts, **json.loads(card)}, character_named(character)))
        )


if __name__ == "__main__":
    with errors_for_people():
        app()
