"""`motionloop data bank`: record what a closed loop asks of its tracker."""

from __future__ import annotations

from collections.abc import Awaitable
from pathlib import Path
from typing import Annotated, Any

import typer

from orchestrator.cli.common import provenance, write_json
from orchestrator.cli.measure import Bar, Planner, Threads, Tracker, with_services
from orchestrator.core.services import Services
from orchestrator.core.supervise import Stack
from orchestrator.evaluation.bank import record_bank, record_tasks
from orchestrator.evaluation.commands import KindsOption


def data_bank(
    out: Annotated[Path, typer.Argument(help="folder for the pieces; those of other seeds are left alone")],
    minutes: Annotated[float, typer.Option(min=0.5, help="simulated time")] = 30.0,
    seed: int = 0,
    kinds: Annotated[KindsOption, typer.Option(help="texts of which kinds of `eval text`")] = "default",
    tasks: Annotated[str, typer.Option(help="in place of texts and points: tasks of `eval tasks`, with commas")] = "",
    episodes: Annotated[int, typer.Option(min=1, help="of each of the tasks")] = 40,
    parallel: Annotated[int, typer.Option(min=1, max=64, help="characters at once")] = 8,
    threads: Threads = 1,
    planner: Planner = None,
    tracker: Tracker = None,
) -> None:
    """Record plans of the closed loop, for training a tracker on them (`train tracker --bank`)."""
    names = [name.strip() for name in tasks.split(",") if name.strip()]

    def job(services: Services, _: Stack) -> Awaitable[dict[str, Any]]:
        if names:
            return record_tasks(services, out, names, episodes, seed, parallel, planner, tracker, bar.update)
        return record_bank(services, out, minutes, seed, parallel, planner, tracker, bar.update, kinds)

    with Bar("episodes" if names else "ticks") as bar:
        result = with_services(job, planner, tracker, threads)
    write_json(out / f"bank_{result['tracker']['name']}_{seed}.json", {**result, **provenance(seed)})
