"""`motionloop eval planner`: how good plans are, without physics (docs/experiments_planner.md).

`--suite quality`, which is what is done where nothing else is asked for, goes on from held-out clips with their texts
and judges that by the frozen evaluator; it also measures targets, keyframes, velocities, text commands and reaches.
`rollouts` and `switches` are in `evaluate_suites`, `--sweep` in `evaluate_sweep`, `--recorded` in `evaluate_recorded`.
"""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import numpy as np
import numpy.typing as npt
import torch
import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from planner_service.dip.planner import DipPlanner
from planner_service.dip.weights import SHIPPED
from planner_service.text.pretrained import minilm
from planner_service.training.dataset import load_material
from planner_service.training.evaluate_conditions import conditions
from planner_service.training.evaluate_loop import COMMANDS, reach, text
from planner_service.training.evaluate_plans import plans
from planner_service.training.evaluate_recorded import judged_recorded, read_recorded
from planner_service.training.evaluate_report import write_report
from planner_service.training.evaluate_retrieval import Heldout, judged, paraphrased
from planner_service.training.evaluate_suites import AFTER_S, BEFORE_S, PROMPTS, rollouts, switches
from planner_service.training.evaluate_sweep import VARIANTS, sweep
from planner_service.training.evaluator.weights import SHIPPED as SHIPPED_EVALUATOR
from planner_service.training.evaluator.weights import Evaluator, load_evaluator
from planner_service.training.export import commit
from shared.console import check_output_file, errors_for_people
from shared.data.cached import cached_corpus
from shared.data.corpus import Corpus
from shared.data.sheet import draw_sheet
from shared.errors import InvalidInputError
from shared.plugins.interfaces import Planner

Array = npt.NDArray[np.float64]
Shown = list[tuple[str, Array]]
SUITES = ("quality", "rollouts", "switches")
REACH_S, TEXT_S = 12, 5
SWITCHES_SHOWN = 24


class Stages:
    """Progress bars, one a stage, on the terminal."""

    def __init__(self, progress: Progress):
        self._progress = progress

    def stage(self, name: str, total: int) -> Callable[[int], None]:
        """A bar of `total`; what is returned moves it on."""
        task = self._progress.add_task(name, total=total)
        return lambda count: self._progress.advance(task, count)


def measure_quality(
    planner: Planner,
    evaluator: Evaluator,
    heldout: Heldout,
    seed: int,
    stages: Stages,
    windows: int,
    reaches: int,
    repeats: int,
) -> tuple[dict[str, object], Shown]:
    """All fields of the suite `quality`, and motions to look at."""
    count, material = len(heldout.texts), heldout.material
    result, made = judged(evaluator, heldout, planner, seed, advance=stages.stage("held-out texts", count))
    # Other noise than above: the two rates are of two draws each.
    advance = stages.stage("paraphrases", len(heldout.paraphrases()[0]))
    result |= paraphrased(evaluator, heldout, planner, made, seed + 1, advance)
    result |= plans(planner, material, windows, seed, stages.stage("targets", windows))
    result |= conditions(planner, material, windows, seed)
    obeyed, shown = text(planner, repeats, seed, TEXT_S, stages.stage("commands", repeats * TEXT_S * len(COMMANDS)))
    result["text"] = obeyed
    result["reach"] = reach(planner, reaches, seed, REACH_S, stages.stage("reaches", reaches * REACH_S))
    look = [(f"{heldout.texts[i]} (from held-out motion)", made[i]) for i in range(0, count, max(1, count // 12))]
    return result, list(shown.items()) + look


def evaluate(
    corpus: Annotated[Path | None, typer.Option(help="folder of a corpus; none: one is built once and kept")] = None,
    suite: Annotated[str | None, typer.Option(help=f"{', '.join(SUITES)}, or several with commas")] = None,
    weights: Annotated[Path, typer.Option(help="safetensors")] = SHIPPED,
    evaluator: Annotated[Path, typer.Option(help="frozen evaluator that judges")] = SHIPPED_EVALUATOR,
    sweep_of: Annotated[
        str | None, typer.Option("--sweep", help=f"a table of settings: all, or some of {', '.join(VARIANTS)}")
    ] = None,
    recorded: Annotated[Path | None, typer.Option(help="folder of recorded episodes to judge")] = None,
    pairs: Annotated[int | None, typer.Option(help="held-out texts; none: all", min=2)] = None,
    windows: Annotated[int, typer.Option(help="held-out windows for single plans", min=7)] = 112,
    reaches: Annotated[int, typer.Option(help="walks to a point", min=1)] = 24,
    repeats: Annotated[int, typer.Option(help="rounds through all text commands", min=1)] = 4,
    seconds: Annotated[int, typer.Option(help="length of a rollout", min=6)] = 60,
    changes: Annotated[int, typer.Option(help="switches of the prompt", min=1)] = 100,
    seed: Annotated[int, typer.Option(min=0)] = 1,
    threads: Annotated[int, typer.Option(min=1)] = 1,
    cache: Annotated[Path | None, typer.Option(help="folder to keep the held-out features in")] = None,
    write_texts: Annotated[
        Path | None, typer.Option(help="only write the held-out sentences, for `eval text --sentences`")
    ] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="where to write the result")] = None,
    report: Annotated[Path | None, typer.Option(help="HTML page with the tables and plots")] = None,
    sheet: Annotated[Path | None, typer.Option(help="PNG of stick figures, a row a motion")] = None,
) -> None:
    """Measure DiP without physics. The same command gives the same numbers on the same machine."""
    torch.set_num_threads(threads)
    only = write_texts is not None or recorded is not None or sweep_of is not None
    wanted = [name.strip() for name in (suite or ("" if only else "quality")).split(",") if name.strip()]
    if not set(wanted) <= set(SUITES):
        raise InvalidInputError(f"unknown suite {suite!r}", field="suite", allowed=", ".join(SUITES))
    for path in (json_file, report, sheet, write_texts):
        check_output_file(path)
    told = None if recorded is None else read_recorded(recorded)
    began = time.monotonic()
    planner = DipPlanner.load(weights)
    result: dict[str, object] = {
        "command": " ".join(["motionloop eval planner", *sys.argv[1:]]),
        "commit": commit(),
        "weights_sha256": planner.spec.weights_sha256,
        "seed": seed,
        "machine": {"cpu": _cpu(), "cores": os.cpu_count(), "threads": threads},
    }
    shown: Shown = []
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True)) as progress:
        stages = Stages(progress)
        if only or "quality" in wanted:
            judge = load_evaluator(minilm(), evaluator)
            result["evaluator_sha256"] = judge.sha256
            heldout = _heldout(corpus, cache, judge, planner, seed, pairs)
            if write_texts is not None:
                write_texts.write_text("".join(f"other\t{text}\n" for text in heldout.texts), encoding="utf-8")
            if "quality" in wanted:
                found, looked = measure_quality(planner, judge, heldout, seed, stages, windows, reaches, repeats)
                result |= found
                shown += looked
            if sweep_of is not None:
                result["sweep"] = sweep(weights, sweep_of, judge, heldout, seed, stages.stage)
            if told is not None:
                advance = stages.stage("the same texts, alone", len(told))
                result["table"] = judged_recorded(judge, heldout, told, planner, seed, advance)
        if "rollouts" in wanted:
            advance = stages.stage("rollouts", len(PROMPTS) * seconds)
            result["rollouts"], looked = rollouts(planner, seed, seconds, advance=advance)
            shown += looked
        if "switches" in wanted:
            advance = stages.stage("switches", changes * (BEFORE_S + AFTER_S))
            result["switches"], looked = switches(planner, seed, changes, advance)
            shown += looked[:SWITCHES_SHOWN]
    result["seconds"] = round(time.monotonic() - began, 1)
    plain = json.dumps(result, indent=1) + "\n"
    if json_file is not None:
        json_file.write_text(plain, encoding="utf-8")
    if report is not None:
        write_report(result, report)
    if sheet is not None and shown:
        draw_sheet(shown, sheet, frames=12)
    sys.stdout.write(plain)


def _heldout(
    folder: Path | None, cache: Path | None, evaluator: Evaluator, planner: Planner, seed: int, pairs: int | None
) -> Heldout:
    corpus = cached_corpus(_told) if folder is None else Corpus.load(folder)
    material = load_material(corpus, "heldout", planner.spec.prefix_frames + planner.spec.plan_frames, cache)
    return Heldout.of(material, evaluator, planner.spec.prefix_frames, seed, pairs)


def _told(stage: str, share: float) -> None:
    typer.echo(f"building the corpus: {stage} {100 * share:.0f} %", err=True)


def _cpu() -> str:
    try:
        found = subprocess.run(["lscpu"], capture_output=True, text=True, check=True).stdout
    except (OSError, subprocess.CalledProcessError):
        return platform.machine()
    names = [line.partition(":")[2].strip() for line in found.splitlines() if line.startswith("Model name")]
    return names[0] if names else platform.machine()


if __name__ == "__main__":
    with errors_for_people():
        typer.run(evaluate)
