"""`motionloop data bank`: record what a closed loop asks of its tracker."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from orchestrator.cli.common import provenance, write_json
from orchestrator.cli.measure import Bar, Planner, Threads, Tracker, with_services
from orchestrator.evaluation.bank import record_bank


def data_bank(
    out: Annotated[Path, typer.Argument(help="folder for the pieces; those of other seeds are left alone")],
    minutes: Annotated[float, typer.Option(min=0.5, help="simulated time")] = 30.0,
    seed: int = 0,
    parallel: Annotated[int, typer.Option(min=1, max=64, help="characters at once")] = 8,
    threads: Threads = 1,
    planner: Planner = None,
    tracker: Tracker = None,
) -> None:
    """Record plans of the closed loop, for training a tracker on them (`train tracker --bank`)."""
    with Bar("ticks") as bar:
        result = with_services(
            lambda services, _: record_bank(services, out, minutes, seed, parallel, planner, tracker, bar.update),
            planner, tracker, threads,
        )  # fmt: skip
    write_json(out / f"bank_{result['tracker']['name']}_{seed}.json", {**result, **provenance(seed)})
