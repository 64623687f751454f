"""`eval tasks`: episodes of one task each, many at a time, in lockstep over the real services."""

from __future__ import annotations

import asyncio
import json
import uuid
from collections.abc import Callable, Sequence
from math import atan2
from pathlib import Path
from typing import Any

import numpy as np

from orchestrator.core.agenda import task_seed
from orchestrator.core.episode import EpisodeOutcome, EpisodeRunner, EpisodeSpec
from orchestrator.core.events import EventLog
from orchestrator.core.services import Services
from orchestrator.core.settings import VARIANTS
from orchestrator.evaluation.starts import octant, start_of
from orchestrator.evaluation.statistics import wilson
from shared.errors import InvalidInputError

Progress = Callable[[int, int, dict[str, Any]], None]
"""Called with episodes done, episodes in all, and the newest row."""


def episode_spec(
    task: str, index: int, seed: int, variant: str, planner: str | None, tracker: str | None
) -> EpisodeSpec:
    """Episode `index` of a task: its own seed and start heading, the same for every variant."""
    if variant not in VARIANTS:
        raise InvalidInputError(f"unknown variant {variant!r}", field="variant", allowed=", ".join(VARIANTS))
    own = task_seed(seed, index)
    start = start_of(task, own)
    return EpisodeSpec.model_validate(
        {
            "tasks": start.tasks,
            "scene": start.scene,
            "seed": own,
            "pacing": "lockstep",
            "heading_rad": start.heading_rad,
            "loop": VARIANTS[variant],
            "planner": planner,
            "tracker": tracker,
        }
    )


async def run_one(spec: EpisodeSpec, services: Services) -> EpisodeOutcome:
    """Run an episode and close its character."""
    runner = EpisodeRunner(str(uuid.uuid4()), spec, services, EventLog())
    outcome = await runner.run()
    if runner.session.created:
        await runner.session.close()
    return outcome


async def evaluate_tasks(
    pairs: Sequence[Services],
    tasks: Sequence[str],
    episodes: int,
    seed: int,
    variant: str = "closed_loop",
    parallel: int = 8,
    planner: str | None = None,
    tracker: str | None = None,
    resume: Path | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Success of each task over `episodes` episodes.

    Args:
        pairs: of planner and tracker; the episodes are spread over them, and the table is the same for any number.
        resume: JSON lines file of finished episodes; those in it are not run again, new ones are added.

    Returns:
        {"tasks": {name: {n, success_strict, success_paper, success_code, ci95, falls, median_time_s, failures}}}.
    """
    wanted = [(task, index) for task in tasks for index in range(episodes)]
    specs = {key: episode_spec(*key, seed, variant, planner, tracker) for key in wanted}
    rows = {key: row for key, row in _done(resume, seed, variant, planner, tracker).items() if key in specs}
    todo = [key for key in wanted if key not in rows]
    gate = asyncio.Semaphore(parallel)

    async def one(place: int, key: tuple[str, int]) -> None:
        async with gate:
            outcome = await run_one(specs[key], pairs[place % len(pairs)])
        row = {**_row(key, seed, variant, outcome), "planner": planner, "tracker": tracker}
        rows[key] = row
        if resume is not None:
            resume.parent.mkdir(parents=True, exist_ok=True)
            with resume.open("a") as file:
                file.write(json.dumps(row) + "\n")
        if progress is not None:
            progress(len(rows), len(wanted), row)

    async with asyncio.TaskGroup() as group:
        for place, key in enumerate(todo):
            group.create_task(one(place, key))
    return {"tasks": {task: summary([rows[task, i] for i in range(episodes)]) for task in tasks}, "variant": variant}


def summary(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Rates with a Wilson interval on the strict one, and what went wrong; `by_octant` of the direction at the start.

    As in the release `success_code` of getting up counts only those that sat.
    """
    n = len(rows)
    strict = sum(row["strict"] for row in rows)
    counted = [row for row in rows if row["measures"].get("was_low", 1.0)]
    octants = sorted({row["octant"] for row in rows if row.get("octant") is not None})
    times = [row["seconds"] for row in rows if row["strict"]]
    low, high = wilson(strict, n)
    return {
        "n": n,
        "success_strict": strict / n,
        "success_paper": sum(row["paper"] for row in rows) / n,
        "success_code": sum(row["code"] for row in counted) / len(counted) if counted else None,
        "ci95": [round(low, 4), round(high, 4)],
        "falls": sum(row["fell"] for row in rows),
        "median_time_s": float(np.median(times)) if times else None,
        "by_octant": {str(which): _share([row for row in rows if row.get("octant") == which]) for which in octants},
        "failures": [{key: row[key] for key in ("index", "reason", "measures")} for row in rows if not row["strict"]],
    }


def _share(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    good = sum(row["strict"] for row in rows)
    low, high = wilson(good, len(rows))
    return {"n": len(rows), "success_strict": good / len(rows), "ci95": [round(low, 4), round(high, 4)]}


def _row(key: tuple[str, int], seed: int, variant: str, outcome: EpisodeOutcome) -> dict[str, Any]:
    """One episode; where it ended before the task that counts, that has failed."""
    start = start_of(key[0], task_seed(seed, key[1]))
    results = [result for result in outcome.results if result.index == len(start.tasks) - 1]
    measures = results[0].measures if results else {}
    bearing = start.bearing_rad
    if bearing is None and "goal_x_m" in measures:
        bearing = atan2(measures["goal_y_m"], measures["goal_x_m"]) - start.heading_rad
    base = {
        "task": key[0], "index": key[1], "seed": seed, "variant": variant, "plans": outcome.plans,
        "octant": None if bearing is None else octant(bearing), "limb": start.tasks[-1].get("limb"),
    }  # fmt: skip
    if not results:
        return {
            **base, "strict": False, "paper": False, "code": False, "fell": False, "seconds": 0.0,
            "reason": outcome.reason, "measures": {},
        }  # fmt: skip
    result = results[0]
    return {
        **base,
        "strict": result.success_strict,
        "paper": result.success_paper,
        "code": result.success_code,
        "fell": result.fell,
        "seconds": result.seconds,
        "reason": result.reason,
        "measures": measures,
    }


def _done(
    path: Path | None, seed: int, variant: str, planner: str | None, tracker: str | None
) -> dict[tuple[str, int], dict[str, Any]]:
    """Finished episodes of the same command. A line that a kill has cut off is taken out of the file."""
    if path is None or not path.exists():
        return {}
    text = path.read_text()
    whole = text[: text.rfind("\n") + 1]
    if whole != text:
        path.write_text(whole)
    rows = [json.loads(line) for line in whole.splitlines()]
    wanted = {"seed": seed, "variant": variant, "planner": planner, "tracker": tracker}
    return {(row["task"], row["index"]): row for row in rows if {key: row.get(key) for key in wanted} == wanted}
