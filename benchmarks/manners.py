"""Which kinds DiP's plans show, without physics, by how they are sampled: the tables of docs/experiments_planner.md.

    python benchmarks/manners.py --kinds kick,punch --guidance 7 --coarse 7
    python benchmarks/manners.py --kinds wave --guidance 1 --coarse 1 --swing 0.3

Four runs of each sentence of `eval text --kinds all`, from standing, replanned every half second for five seconds.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
import torch
import typer

from orchestrator.evaluation.commands import ALL
from planner_service.dip.deeds import DEEDS
from planner_service.dip.manner import MANNERS, Manner
from planner_service.dip.planner import DipPlanner, DipSettings
from planner_service.training.rollout import Rollout
from shared.motion.ik import standing_clip
from shared.motion.skeleton import CANONICAL
from shared.protocol.messages import PLANNER_FPS
from shared.tasks.interface import PlanGoal
from shared.tasks.kinds import judge

REPEATS, REPLAN_FRAMES, PLANS = 4, 10, 10


def swing_m(positions_w_m: np.ndarray, side: str) -> float:
    """How far a wrist swings about its shoulder within a second, in (T, 22, 3) at PLANNER_FPS: the median over time."""
    shoulder, wrist = CANONICAL.indices(f"{side}_shoulder", f"{side}_wrist")
    hand = positions_w_m[:, wrist] - positions_w_m[:, shoulder]
    pieces = (hand[i : i + PLANNER_FPS] for i in range(0, len(hand) - PLANNER_FPS, PLANNER_FPS // 2))
    centred = (piece - piece.mean(axis=0) for piece in pieces)
    return float(np.median([np.ptp(c @ np.linalg.svd(c, full_matrices=False)[2][0]) for c in centred]))


def main(
    kinds: Annotated[str, typer.Option(help=f"some of {', '.join(ALL)}")] = "wave,kick,punch,step_side",
    guidance: Annotated[float | None, typer.Option(help="none: as shipped, and so with the other two")] = None,
    coarse: Annotated[float, typer.Option(help="at most this in the noisiest steps")] = 2.5,
    swing: Annotated[float, typer.Option(help="share by which arms swing more in a step")] = 0.0,
    seed: Annotated[int, typer.Option()] = 1,
) -> None:
    """Print the share of runs that show each kind, and the swing of waves."""
    torch.set_num_threads(1)
    settings = DipSettings()
    if guidance is not None:
        settings = DipSettings(guidance=guidance, coarse_guidance=coarse)
        DEEDS.clear()
        MANNERS.clear()
        MANNERS.update(dict.fromkeys(("wave", "wave_both"), Manner(guidance, coarse, swing)))
    planner = DipPlanner.load(settings=settings)
    start = standing_clip(planner.spec.prefix_frames, PLANNER_FPS).positions_w_m
    for name in kinds.split(","):
        asked = [pair for pair in ALL[name] for _ in range(REPEATS)]
        rollout = Rollout(planner, np.repeat(start[None], len(asked), axis=0), seed, REPLAN_FRAMES)
        for _ in range(PLANS):
            rollout.step(lambda body, view: PlanGoal(text=asked[body][1]))  # noqa: B023 - used at once
        done = [judge(kind, rollout.trace(body, len(start))).done for body, (kind, _) in enumerate(asked)]
        line = f"{name}: {np.mean(done):.2f} of {len(done)}"
        if name == "wave":
            sides = [(body, kind.partition("_")[2]) for body, (kind, _) in enumerate(asked) if "_" in kind]
            swings = [swing_m(rollout.frames(body)[2 * len(start) :], side) for body, side in sides]
            line += f"; swing {100 * float(np.median(swings)):.1f} cm"
        typer.echo(line)


if __name__ == "__main__":
    typer.run(main)
