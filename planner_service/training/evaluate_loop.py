"""Reaching and text commands in the closed loop of `rollout`, without physics, by the rules of `shared.tasks`."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from planner_service.training.evaluate_quality import contact_slide_mm
from planner_service.training.rollout import Rollout
from shared.motion.ik import standing_clip
from shared.motion.metrics import jerk_mps3
from shared.plugins.interfaces import Planner
from shared.protocol.rates import PLANNER_FPS as FPS
from shared.tasks.builtin import ReachTask
from shared.tasks.interface import BodyView, PlanGoal
from shared.tasks.obey import kind_of, obeyed
from shared.tasks.specs import ReachSpec

Array = npt.NDArray[np.float64]
Advance = Callable[[int], None]


def nothing(count: int) -> None:
    """No progress is shown."""


COMMANDS = (
    "a person walks forward.",
    "walk",
    "a person is running.",
    "run forward",
    "turn left",
    "a person turns around to the right.",
    "a person waves with the right hand.",
    "wave with the left hand",
    "a person jumps.",
    "jump",
    "a person is standing still.",
    "stand still",
)


def reach(
    planner: Planner, episodes: int, seed: int, seconds: int = 12, advance: Advance = nothing
) -> dict[str, object]:
    """Walk from standing to random points 1-3 m away in any direction, replanning every second."""
    start = np.repeat(standing_clip(20, FPS).positions_w_m[None], episodes, 0)
    rollout = Rollout(planner, start, seed)
    tasks = [ReachTask(ReachSpec(), seed + i) for i in range(episodes)]
    for body, task in enumerate(tasks):
        task.start(BodyView(0, start[body, -1]))
    for _ in range(seconds):
        rollout.step(lambda body, view: tasks[body].goal(view, rollout.tick))
        advance(episodes)
    verdicts = [task.judge(rollout.trace(i, 19)) for i, task in enumerate(tasks)]
    met = [v.seconds for v in verdicts if v.code]
    missed = [{k: round(x, 2) for k, x in v.measures.items()} for v in verdicts if not v.strict]
    return {
        "episodes": episodes,
        "reached": sum(v.code for v in verdicts) / episodes,
        "reached_and_held": sum(v.strict for v in verdicts) / episodes,
        "median_time_s": float(np.median(met)) if met else None,
        "missed": missed,
        "skating_contact_mm": float(np.mean([contact_slide_mm(rollout.frames(i)) for i in range(episodes)])),
    }


def text(
    planner: Planner, repeats: int, seed: int, seconds: int = 5, advance: Advance = nothing
) -> tuple[dict[str, object], dict[str, Array]]:
    """Every command `repeats` times, each after another one, five seconds each; also motions to look at, by command."""
    rng = np.random.default_rng(seed)
    order = [list(rng.permutation(len(COMMANDS))) for _ in range(repeats)]
    rollout = Rollout(planner, np.repeat(standing_clip(20, FPS).positions_w_m[None], repeats, 0), seed)
    tally: dict[str, list[bool]] = {}
    misses: list[str] = []
    shown: dict[str, Array] = {}
    for k in range(len(COMMANDS)):
        since = rollout.lengths()[0] - 1
        for _ in range(seconds):
            rollout.step(lambda body, view: PlanGoal(text=COMMANDS[order[body][k]]))  # noqa: B023 - used at once
            advance(repeats)
        for body in range(repeats):
            command = COMMANDS[order[body][k]]
            result = obeyed(command, rollout.trace(body, since))
            tally.setdefault(kind_of(command), []).append(result.obeyed)
            shown.setdefault(command, rollout.frames(body)[since:])
            if not result.obeyed:
                before = COMMANDS[order[body][k - 1]] if k else "start"
                measures = {name: round(v, 2) for name, v in result.measures.items()}
                misses.append(f"{command} (after {before}): {measures}")
    by_kind = {kind: sum(found) / len(found) for kind, found in sorted(tally.items())}
    total = sum(sum(found) for found in tally.values()) / (repeats * len(COMMANDS))
    every = [rollout.frames(i) for i in range(repeats)]
    return {
        "commands": repeats * len(COMMANDS),
        "obeyed": total,
        "by_kind": by_kind,
        "missed": misses,
        "skating_contact_mm": float(np.mean([contact_slide_mm(f) for f in every])),
        "jerk": float(np.mean([jerk_mps3(f, FPS) for f in every])),
    }, shown
