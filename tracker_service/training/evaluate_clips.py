"""`motionloop eval tracker`: how well the shipped policy follows clips, recorded or held out of a corpus (DESIGN 8).

`--clips DIR` takes motion files (BVH, ASF + AMC, SMPL npz; any reasonable skeleton is retargeted), `--corpus DIR` the
held-out clips of a corpus; `--suite` what `suites.SUITES` names, in place of clips.
"""

from __future__ import annotations

import json
import platform
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
import typer

from shared.console import EXPECTED, as_ours, check_output_file, errors_for_people
from shared.data.cached import cached_corpus
from shared.data.corpus import Corpus
from shared.data.reading import Outcome, read_all, summary
from shared.errors import InvalidInputError
from shared.motion.io.files import motion_files
from shared.motion.io.options import ReadOptions, read_joint_map
from shared.motion.resampling import resample
from shared.protocol.rates import TICK_HZ
from tracker_service.policy.learned import WEIGHTS
from tracker_service.simulation.character_spec import HUMAN
from tracker_service.simulation.humanoid import humanoid
from tracker_service.training.dataset import LARGEST_CHANGE_RAD, MotionInput, hinges_jump, prepare, seat_in
from tracker_service.training.evaluate import evaluate
from tracker_service.training.policies import policy_of
from tracker_service.training.suites import SUITES, run_suite

F32 = npt.NDArray[np.float32]
LEAST_TICKS = 30
TRACKERS = ("learned", "ppo", "pd")
"""`ppo` is the trained policy's former name."""


def motions_of_files(
    folder: Path, options: ReadOptions | None = None, say: Callable[[str], None] = lambda line: None
) -> tuple[list[MotionInput], list[Outcome]]:
    """Clips of a file or of all motion files below a folder, at 30 Hz, and what came of each file.

    The behaviour is the name of the folder a file lies in. `say` is told a row for each file, and its warnings.

    Raises:
        InvalidInputError: there is no motion file.
    """
    motions: list[MotionInput] = []
    outcomes: list[Outcome] = []
    for outcome in read_all(motion_files(folder), folder, options):
        if outcome.loaded is not None:
            positions = resample(outcome.loaded.clip.positions_w_m, outcome.loaded.clip.fps, TICK_HZ)
            if len(positions) < LEAST_TICKS:
                outcome = replace(outcome, loaded=None, left_out=f"shorter than {LEAST_TICKS / TICK_HZ:g} s")
            else:
                motions.append(MotionInput(outcome.file.stem, outcome.file.parent.name, 1.0, positions))
        outcomes.append(outcome)
        for line in outcome.lines():
            say(line)
    return motions, outcomes


def told_of_files(outcomes: list[Outcome]) -> dict[str, Any]:
    """Fields of the result on the files: `files`, `left_out` (all that were not judged, with the reason), `errors`."""
    return {
        "files": [outcome.as_dict() for outcome in outcomes],
        "left_out": {o.label: o.left_out or o.error for o in outcomes if o.loaded is None},
        "errors": {o.label: o.error for o in outcomes if o.error},
    }


def motions_of_corpus(folder: Path, split: str) -> list[MotionInput]:
    """Clips of one split of a corpus; mirror images are not judged a second time."""
    corpus = Corpus.load(folder)
    return [
        MotionInput(clip.name, clip.behaviour, 1.0, corpus.positions(i), seat_in(clip))
        for i, clip in enumerate(corpus.clips)
        if clip.split == split and clip.frames >= LEAST_TICKS and not clip.mirrored
    ]


def evaluate_weights(
    motions: list[MotionInput], weights: Path | None = WEIGHTS, leave_out: bool = False
) -> dict[str, Any]:
    """Fields of DESIGN 8 for a policy file, or for the `pd` baseline where `weights` is None.

    Args:
        leave_out: judge no clip whose hinge angles jump; `left_out` tells them with the reason.
    """
    human = humanoid(HUMAN)
    settings, policy = policy_of(human, weights)
    references = prepare(human, motions)
    if not leave_out:
        return evaluate(settings, references, human, policy)
    jumping = hinges_jump(references)
    reason = f"a hinge jumps by more than {LARGEST_CHANGE_RAD:g} rad in a tick"
    result = evaluate(settings, references, human, policy, which=np.flatnonzero(~jumping))
    return result | {"left_out": {str(name): reason for name in references.names[jumping]}}


def _interval(row: dict[str, Any]) -> str:
    low, high = row["ci95"]
    return f"({low:.2f}-{high:.2f})"


def _told(stage: str, share: float) -> None:
    typer.echo(f"building the corpus: {stage} {100 * share:.0f} %", err=True)


app = typer.Typer(add_completion=False)


@app.command()
def main(
    clips: Annotated[Path | None, typer.Option(help="file or folder of motion files")] = None,
    corpus: Annotated[Path | None, typer.Option(help="corpus whose held-out clips are followed")] = None,
    suite: Annotated[str | None, typer.Option(help=f"in place of clips: {', '.join(SUITES)}")] = None,
    weights: Annotated[Path, typer.Option(help="policy to judge")] = WEIGHTS,
    tracker: Annotated[str, typer.Option(help="learned, or pd for the baseline")] = "learned",
    json_file: Annotated[Path | None, typer.Option("--json", help="where to write the result")] = None,
    seed: Annotated[int, typer.Option(help="noted in the result; the evaluation has no randomness")] = 0,
    fps: Annotated[float | None, typer.Option(help="frames per second of the files, in place of what they say")] = None,
    up: Annotated[str, typer.Option(help="vertical axis of the files: x, y or z; auto finds it")] = "auto",
    unit: Annotated[float | None, typer.Option(metavar="METRES", help="metres in one unit of the files")] = None,
    joints: Annotated[Path | None, typer.Option(metavar="FILE", help="JSON of our joint names to the files'")] = None,
    root: Annotated[str | None, typer.Option(metavar="NAME", help="which of several roots of a BVH")] = None,
) -> None:
    """Follow every clip once and report success, errors and falls by behaviour; exit code 1 if a file is unreadable."""
    if (clips is not None) + (corpus is not None) != 1 if suite is None else clips is not None:
        raise typer.BadParameter("give either --clips or --corpus, or --suite")
    if suite is not None and suite not in SUITES:
        raise typer.BadParameter(f"unknown suite {suite!r}; known: {', '.join(SUITES)}")
    if tracker not in TRACKERS:
        raise typer.BadParameter(f"unknown tracker {tracker!r}; known: {', '.join(TRACKERS)}")
    check_output_file(json_file)
    made_with = {"tracker": tracker, "weights": str(weights), "seed": seed}
    made_with["machine"] = f"{platform.machine()} {platform.system()} {platform.release()}"

    def write(result: dict[str, Any]) -> None:
        if json_file is not None:
            json_file.write_text(json.dumps(result | made_with, indent=2) + "\n", encoding="utf-8")

    policy_file = None if tracker == "pd" else weights
    if suite is not None:
        human = humanoid(HUMAN)
        settings, policy = policy_of(human, policy_file)
        result = run_suite(suite, human, settings, policy, Corpus.load(corpus) if corpus else cached_corpus(_told))
        write({"suite": suite, **result})
        typer.echo(json.dumps({k: v for k, v in result.items() if k != "per_clip"}, indent=2))
        return
    outcomes: list[Outcome] = []
    try:
        if clips is not None:
            options = ReadOptions(fps, up.lower(), unit, read_joint_map(joints) if joints is not None else None, root)
            motions, outcomes = motions_of_files(clips, options, typer.echo)
            typer.echo(summary(outcomes))
        else:
            assert corpus is not None
            motions = motions_of_corpus(corpus, "heldout")
        if not motions:
            raise InvalidInputError(f"no clip at {clips or corpus} can be followed", field="clips")
        result = told_of_files(outcomes) | evaluate_weights(motions, policy_file, leave_out=corpus is not None)
    except EXPECTED as error:
        write({"clips": 0, "error": as_ours(error).message, **told_of_files(outcomes)})
        raise
    write(result)
    for name, row in [*sorted(result["by_behaviour"].items()), *result["by_group"].items()]:
        typer.echo(f"{name:14} {row['success']:.2f} {_interval(row)} of {row['clips']:3}  {row['mpjpe_mm']:.0f} mm")
    typer.echo(
        f"success {result['success']:.3f} {_interval(result)} of {result['clips']}, {result['mpjpe_mm']:.0f} mm, "
        f"{result['falls_per_min']:.2f} falls a minute"
    )
    if clips is None:
        for name, reason in result["left_out"].items():
            typer.echo(f"left out: {name}: {reason}")
    if any(outcome.error for outcome in outcomes):
        raise typer.Exit(1)


if __name__ == "__main__":
    with errors_for_people():
        app()
