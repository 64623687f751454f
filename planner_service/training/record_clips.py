"""`python -m planner_service.training.record_clips`: DiP's own motion as the library of the planner `clip`.

Recorded motion may not be shipped (NOTICE), motion that our own loop performed may. Every sentence is performed a few
times from standing, without physics; only performances that show what the sentence says are kept.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from planner_service.builtin.library import save_clip
from planner_service.dip.planner import DipPlanner
from planner_service.service.settings import DEFAULT_LIBRARY
from planner_service.training.rollout import Rollout
from shared.motion.ik import standing_clip
from shared.protocol.messages import PLANNER_FPS
from shared.protocol.rates import TICK_HZ
from shared.tasks.interface import PlanGoal
from shared.tasks.obey import obeyed

SENTENCES: dict[str, tuple[str, ...]] = {
    "walk": ("a person walks forward.", "walk"),
    "run": ("a person runs forward.", "run", "jog"),
    "turn_left": ("a person turns to the left.", "turn left"),
    "turn_right": ("a person turns to the right.", "turn right"),
    "wave_right": ("a person waves with the right hand.", "wave"),
    "wave_left": ("a person waves with the left hand.", "wave with the left hand"),
    "jump": ("a person jumps.", "jump"),
    "stand": ("a person is standing still.", "stand"),
}
"""What is recorded: the first sentence is performed, all of them describe the clip."""


def record(planner: DipPlanner, folder: Path, seed: int, tries: int, seconds: int) -> dict[str, int]:
    """Perform every sentence `tries` times; which sentence (by name) gave how many clips."""
    prefix = planner.spec.prefix_frames
    names = [name for name in SENTENCES for _ in range(tries)]
    start = standing_clip(prefix, PLANNER_FPS).positions_w_m
    rollout = Rollout(planner, np.stack([start] * len(names)), seed)
    while rollout.tick < seconds * TICK_HZ:
        rollout.step(lambda body, view: PlanGoal(text=SENTENCES[names[body]][0]))
    kept = dict.fromkeys(SENTENCES, 0)
    for body, name in enumerate(names):
        if obeyed(SENTENCES[name][0], rollout.trace(body, prefix)).obeyed:
            save_clip(folder, f"{name}_{kept[name]}", SENTENCES[name], rollout.frames(body)[prefix - 1 :], PLANNER_FPS)
            kept[name] += 1
    return kept


def main(
    folder: Annotated[Path, typer.Option(help="where the clips go")] = DEFAULT_LIBRARY,
    weights: Annotated[Path | None, typer.Option(help="other weights than the shipped ones")] = None,
    seed: int = 1,
    tries: int = 3,
    seconds: int = 6,
) -> None:
    """Record the library anew; clips that are there already are replaced name by name."""
    planner = DipPlanner.load(weights)
    kept = record(planner, folder, seed, tries, seconds)
    card = {
        "command": f"python -m planner_service.training.record_clips --seed {seed} --tries {tries} --seconds {seconds}",
        "weights": planner.spec.weights_sha256,
        "clips": kept,
    }
    (folder / "card.json").write_text(json.dumps(card, indent=1) + "\n", encoding="utf-8")
    typer.echo(json.dumps(card, indent=1))


if __name__ == "__main__":
    typer.run(main)
