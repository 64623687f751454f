"""`eval tasks`: episodes of one task each, many at a time, in lockstep over the real services."""

from __future__ import annotations

import logging
import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import atan2
from pathlib import Path
from typing import Any

import numpy as np

from orchestrator.core.agenda import task_seed
from orchestrator.core.episode import EpisodeRunner
from orchestrator.core.episode_spec import EpisodeOutcome, EpisodeSpec
from orchestrator.core.events import EventLog
from orchestrator.core.services import Services
from orchestrator.core.settings import VARIANTS
from orchestrator.evaluation.executor import Executor
from orchestrator.evaluation.parquet import write_parquet
from orchestrator.evaluation.pushes import Pushes
from orchestrator.evaluation.rows import Key, Measured, Row, finished, keep
from orchestrator.evaluation.sequences import SEQUENCE, sequence_of
from orchestrator.evaluation.starts import Start, octant, start_of
from shared.errors import InvalidInputError, MotionLoopError
from shared.protocol.messages import Render, Video
from shared.statistics import wilson

_LOG = logging.getLogger(__name__)
Progress = Callable[[int, int, Row], None]
"""Called with episodes done, episodes in all, and the newest row."""
FILM_S = 600.0
PATIENT = {"plan_timeout_s": 600.0, "tracker_timeout_s": 600.0}
"""A busy machine is no outage: a request that timed out would change what the episode shows."""


def start_for(key: Key, measured: Measured) -> Start:
    """How episode `key` begins: the same for every variant and all weights."""
    task, index = key
    own = task_seed(measured.seed, index)
    return sequence_of(own) if task == SEQUENCE else start_of(task, own, measured.varied)


def episode_spec(key: Key, measured: Measured) -> EpisodeSpec:
    """Episode `index` of a task: its own seed and start, the same for every variant."""
    if measured.variant not in VARIANTS:
        raise InvalidInputError(f"unknown variant {measured.variant!r}", field="variant", allowed=", ".join(VARIANTS))
    start = start_for(key, measured)
    return EpisodeSpec.model_validate(
        {
            "tasks": start.tasks,
            "scene": start.scene,
            "seed": task_seed(measured.seed, key[1]),
            "pacing": "lockstep",
            "heading_rad": start.heading_rad,
            "loop": VARIANTS[measured.variant].model_copy(update=PATIENT),
            "planner": measured.planner,
            "tracker": measured.tracker,
        }
    )


@dataclass(frozen=True)
class EpisodeJob:
    """One episode to run: which, of what measurement, and whether to film it where it fails."""

    key: Key
    measured: Measured
    film: bool = False


async def run_episode(services: Services, job: EpisodeJob) -> tuple[Row, bytes | None]:
    """Run an episode and close its character; its row, and an MP4 if one was asked for and a task failed."""
    spec, push_ns = episode_spec(job.key, job.measured), job.measured.push_ns
    runner = EpisodeRunner(str(uuid.uuid4()), spec, services, EventLog())
    if push_ns > 0:
        runner.on_cycle = Pushes(runner, spec.seed, push_ns)
    outcome = await runner.run()
    row = job.measured.stamped(_row(job.key, start_for(job.key, job.measured), outcome))
    film: bytes | None = None
    if not runner.session.created:
        return row, film
    try:
        if job.film and not outcome.success and runner.tick > 0:
            ask = Render(start_tick=0, stop_tick=runner.tick, width=480, height=360)
            video = await runner.session.loop.ask_tracker(Video, ask, FILM_S)
            film = np.asarray(video.mp4).tobytes()
    except MotionLoopError as error:  # the rows of hours are worth more than a video
        _LOG.warning("no video of %s: %s", job.key, error)
    finally:
        await runner.session.close()
    return row, film


async def evaluate_tasks(
    executor: Executor,
    tasks: Sequence[str],
    episodes: int,
    measured: Measured,
    resume: Path | None = None,
    progress: Progress | None = None,
    videos: Path | None = None,
    parquet: Path | None = None,
) -> dict[str, Any]:
    """Success of each task over `episodes` episodes.

    Args:
        executor: an open one, where the episodes run; the table is the same for any.
        measured: with the weights of what answers there.
        tasks: names; `sequence` stands for five random tasks in one scene.
        resume: JSON lines file of finished episodes; those in it are not run again, new ones are added.
        videos: folder for a video of every episode that fails.
        parquet: file for the rows, one an episode, in the order of tasks and numbers.

    Returns:
        {"tasks": {name: {n, success_strict, success_paper, success_code, ci95, falls, median_time_s, failures}}}.
    """
    wanted = [(task, index) for task in tasks for index in range(episodes)]
    for key in wanted:
        episode_spec(key, measured)  # what is wrong with one is told before the first has run
    known = set(wanted)
    rows = {key: row for key, row in finished(resume, measured).items() if key in known}

    def done(job: EpisodeJob, result: tuple[Row, bytes | None]) -> None:
        rows[job.key], film = result
        keep(resume, rows[job.key])
        if videos is not None and film is not None:
            _save_film(videos / f"{job.key[0]}_{measured.variant}_{measured.seed}_{job.key[1]:03d}.mp4", film)
        if progress is not None:
            progress(len(rows), len(wanted), rows[job.key])

    await executor.run(
        run_episode, [EpisodeJob(key, measured, videos is not None) for key in wanted if key not in rows], done
    )
    if parquet is not None:
        write_parquet(parquet, [rows[key] for key in wanted])
    table = {task: summary([rows[task, i] for i in range(episodes)]) for task in tasks}
    what = {"variant": measured.variant, "varied": measured.varied, "push_ns": measured.push_ns}
    return {"tasks": table, **what, "weights": measured.weights}


def _save_film(path: Path, film: bytes) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(film)
    except OSError as error:  # as above
        _LOG.warning("no video %s: %s", path, error)


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


def _row(key: Key, start: Start, outcome: EpisodeOutcome) -> Row:
    """One episode. A sequence counts as a whole; else the last task does, and it has failed where the episode ended
    before it."""
    task, index = key
    results = outcome.results if task == SEQUENCE else [r for r in outcome.results if r.index == len(start.tasks) - 1]
    complete = len(results) == (len(start.tasks) if task == SEQUENCE else 1)
    measures = dict(results[-1].measures) if results and task != SEQUENCE else {}
    if task == SEQUENCE:
        measures = {"done": float(sum(result.success_strict for result in results)), "tasks": float(len(start.tasks))}
    bearing = start.bearing_rad
    if bearing is None and "goal_x_m" in measures:
        bearing = atan2(measures["goal_y_m"], measures["goal_x_m"]) - start.heading_rad
    failed = next((result for result in results if not result.success_strict), None)
    reason = outcome.reason if failed is None else failed.reason
    return {
        "task": task,
        "index": index,
        "plans": outcome.plans,
        "octant": None if bearing is None else octant(bearing),
        "limb": start.tasks[-1].get("limb"),
        "strict": complete and all(result.success_strict for result in results),
        "paper": complete and all(result.success_paper for result in results),
        "code": complete and all(result.success_code for result in results),
        "fell": any(result.fell for result in results),
        "seconds": round(sum(result.seconds for result in results), 3),
        "reason": f"{failed.type}: {reason}" if failed is not None and task == SEQUENCE else reason,
        "measures": measures,
    }
