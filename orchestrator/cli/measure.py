"""`motionloop eval ...`, `motionloop bench ...`: start the services, measure, write JSON."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Awaitable, Callable
from dataclasses import replace
from json import loads
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from orchestrator.cli.common import JsonFile, console, for_people, provenance, writable, write_json
from orchestrator.cli.delegate import PASS_THROUGH, module_json, run_module
from orchestrator.core.services import Services
from orchestrator.core.supervise import Stack
from orchestrator.evaluation import bench as benches
from orchestrator.evaluation.commands import KindsOption, read_sentences
from orchestrator.evaluation.executor import Answering, Executor, ExecutorName, LocalProcesses, Pairing
from orchestrator.evaluation.on_ray import RayCluster
from orchestrator.evaluation.parquet import check_parquet
from orchestrator.evaluation.report import write_report
from orchestrator.evaluation.rows import Measured
from orchestrator.evaluation.sequences import SEQUENCE
from orchestrator.evaluation.tasks import evaluate_tasks
from orchestrator.evaluation.text import TextPlan, evaluate_text
from shared.errors import InvalidInputError

evaluate = typer.Typer(no_args_is_help=True, help="Measure how well it works.")
MOST_CHARACTERS = 32
bench = typer.Typer(no_args_is_help=True, help="Measure how fast it is.")

Planner = Annotated[str | None, typer.Option(help="planner plug-in")]
Tracker = Annotated[str | None, typer.Option(help="tracker plug-in")]
Threads = Annotated[int, typer.Option(help="CPU threads of the planner")]
FIXED = {"pacing": "lockstep", "planner_batch": 1, "seeds": "one an episode or stream, from --seed"}
"""What makes an evaluation repeat: the same command gives the same table on the same machine."""
WITHOUT_AVX512 = {
    "ATEN_CPU_CAPABILITY": "avx2",
    "ONEDNN_MAX_CPU_ISA": "AVX2",
    "DNNL_MAX_CPU_ISA": "AVX2",
    "MKL_ENABLE_INSTRUCTIONS": "AVX2",
}
"""Keeps torch, oneDNN (in torch and in OpenVINO) and MKL from AVX-512."""
Job = Callable[[Services, Stack], Awaitable[dict[str, Any]]]
ONE_PLAN_A_BATCH = ("--max-batch", "1")
"""What else is in a batch changes the last bits of a plan, and which requests meet in one depends on the clock; chaotic
as bodies are, a table would differ from run to run."""


def with_services(
    job: Job, planner: str | None, tracker: str | None, threads: int, repeatable: bool = False
) -> dict[str, Any]:
    """Run a measurement over a planner and a tracker of its own; adds what they were.

    Args:
        repeatable: plan for one character at a time.
    """
    pairing = Pairing(planner, tracker, threads, ONE_PLAN_A_BATCH if repeatable else ())
    stack = pairing.stack(console.print)

    async def run() -> dict[str, Any]:
        services = await pairing.connect(stack)
        try:
            return _told(await job(services, stack), Answering.of(services, pairing), threads, repeatable)
        finally:
            await services.close()

    try:
        with for_people():
            return asyncio.run(run())
    finally:
        stack.stop()


def with_executor(
    job: Callable[[Executor, Answering], Awaitable[dict[str, Any]]], executor: Executor, threads: int
) -> dict[str, Any]:
    """Run a measurement that repeats over the pairs of an executor; adds what they were."""

    async def run() -> dict[str, Any]:
        try:
            answering = await executor.open()
            return _told(await job(executor, answering), answering, threads, repeatable=True)
        finally:
            await executor.close()

    with for_people(), executor:
        return asyncio.run(run())


def _told(result: dict[str, Any], answering: Answering, threads: int, repeatable: bool) -> dict[str, Any]:
    return {
        **result,
        "planner": answering.planner,
        "tracker": answering.tracker,
        "planner_threads": threads,
        **({"deterministic": True, "fixed": {**FIXED, "planner_threads": threads}} if repeatable else {}),
    }


def make_executor(name: ExecutorName, ray_address: str | None, pairing: Pairing, pairs: int, parallel: int) -> Executor:
    """The executor of this name, not yet open. Raises InvalidInputError where it cannot be had."""
    if name == "ray":
        return RayCluster(pairing, pairs, parallel, ray_address, console.print)
    if ray_address is not None:
        raise InvalidInputError("an address of Ray is for --executor ray", field="ray_address")
    return LocalProcesses(pairing, pairs, parallel, console.print)


class Bar:
    """A progress bar whose description says how it is going."""

    def __init__(self, what: str):
        self._what = what
        self._good = 0
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        self._progress = Progress(*columns, console=console)
        self._task = self._progress.add_task(what, total=None)

    def __enter__(self) -> Bar:
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def update(self, done: int, total: int, row: dict[str, Any]) -> None:
        self._good += bool(row.get("strict", row.get("obeyed")))
        text = f"{self._what}: {self._good} good"
        self._progress.update(self._task, completed=done, total=total, description=text)


@evaluate.command("tasks")
def eval_tasks(
    tasks: Annotated[str, typer.Option(help="task names with commas")] = "reach",
    episodes: Annotated[int, typer.Option(min=1)] = 20,
    sequences: Annotated[int, typer.Option(min=0, help="so many sequences of five random tasks in one scene")] = 0,
    seed: int = 1,
    variant: Annotated[
        str, typer.Option(help="closed_loop, open_loop, no_finetune, paper, short or long")
    ] = "closed_loop",
    varied: Annotated[bool, typer.Option("--varied", help="sizes of objects 20 % off, seats of 0.2 to 0.6 m")] = False,
    push: Annotated[
        float, typer.Option(min=0.0, max=400.0, help="push the pelvis once in each task, N s, from any side")
    ] = 0.0,
    parallel: Annotated[int, typer.Option(min=1, max=64, help="episodes at once")] = 8,
    jobs: Annotated[int, typer.Option(min=1, max=64, help="pairs of planner and tracker, a core or two each")] = 1,
    threads: Threads = 1,
    planner: Planner = None,
    tracker: Tracker = None,
    planner_weights: Annotated[Path | None, typer.Option(exists=True, help="weights of dip")] = None,
    tracker_weights: Annotated[Path | None, typer.Option(exists=True, help="weights of learned")] = None,
    resume: Annotated[Path | None, typer.Option(help="JSON lines of finished episodes, to go on from")] = None,
    report: Annotated[
        Path | None, typer.Option(help="write the table as Markdown, with plots beside it", callback=writable)
    ] = None,
    against: Annotated[Path | None, typer.Option(exists=True, help="an earlier --json to compare with")] = None,
    videos: Annotated[Path | None, typer.Option(help="folder for videos of the episodes that fail")] = None,
    executor: Annotated[
        ExecutorName, typer.Option(help="where the pairs are: on this machine, or on a Ray cluster")
    ] = "local",
    ray_address: Annotated[
        str | None, typer.Option(help="HOST:PORT of the Ray cluster, or auto; default: one of this machine")
    ] = None,
    parquet: Annotated[
        Path | None, typer.Option(help="write the rows of episodes as Parquet", callback=writable)
    ] = None,
    json: JsonFile = None,
) -> None:
    """Success rates of tasks (strict, paper, code) with a Wilson interval."""
    names = [SEQUENCE] if sequences else [name.strip() for name in tasks.split(",") if name.strip()]
    measured = Measured(seed, variant, planner, tracker, varied, push)
    with Bar("episodes") as bar:
        with for_people():
            there = None if against is None else loads(against.read_text(encoding="utf-8"))
            if there is not None and not (isinstance(there, dict) and {"tasks", "variant"} <= there.keys()):
                raise InvalidInputError(f"{against} is no result of eval tasks", field="against")
            if parquet is not None:
                check_parquet()
            if variant == "no_finetune" and tracker_weights is None:
                raise InvalidInputError(
                    "no_finetune needs weights that have seen no plans", field="variant", allowed="--tracker-weights"
                )
            pairing = Pairing(planner, tracker, threads, ONE_PLAN_A_BATCH, planner_weights, tracker_weights)
            runs_on = make_executor(executor, ray_address, pairing, jobs, parallel)
        result = with_executor(
            lambda on, answering: evaluate_tasks(
                on, names, sequences or episodes, replace(measured, weights=answering.weights), resume, bar.update,
                videos, parquet,
            ),
            runs_on, threads,
        )  # fmt: skip
    whole = {**result, **provenance(seed)}
    write_json(json, whole)
    if report is not None:
        write_report(report, whole, there)


@evaluate.command("text")
def eval_text(
    minutes: Annotated[
        float, typer.Option(min=0.05, help="of simulated time; with --sentences each is asked once")
    ] = 10.0,
    kinds: Annotated[KindsOption, typer.Option(help="the six kinds, or all by strict rules")] = "default",
    sentences: Annotated[Path | None, typer.Option(help="in their place: lines of KIND, tab, sentence")] = None,
    record: Annotated[Path | None, typer.Option(help="folder for a .npz of every command, for eval planner")] = None,
    seed: int = 1,
    every_s: Annotated[float, typer.Option(min=1.0, help="a new command every so many seconds")] = 5.0,
    parallel: Annotated[int, typer.Option(min=1, max=64, help="characters that share the time")] = 4,
    threads: Threads = 1,
    planner: Planner = None,
    tracker: Tracker = None,
    json: JsonFile = None,
) -> None:
    """How many text commands are obeyed, and how often it falls."""
    with for_people():
        listed = () if sentences is None else tuple(read_sentences(sentences))
    plan = TextPlan(minutes, every_s, kinds, listed, record)
    with Bar("commands") as bar:
        result = with_services(
            lambda services, stack: evaluate_text(
                services, plan, seed, parallel, planner, tracker, progress=bar.update
            ),
            planner, tracker, threads, repeatable=True,
        )  # fmt: skip
    write_json(json, {**result, **provenance(seed)})


@evaluate.command("tracker", context_settings=PASS_THROUGH)
def eval_tracker(context: typer.Context) -> None:
    """How well clips are tracked; options as of `python -m tracker_service.training.evaluate_clips`."""
    run_module("tracker_service.training.evaluate_clips", context.args)


@evaluate.command("planner", context_settings=PASS_THROUGH)
def eval_planner(context: typer.Context) -> None:
    """Quality of plans; options as of `python -m planner_service.training.evaluate`."""
    run_module("planner_service.training.evaluate", context.args)


@bench.command("loop")
def bench_loop(
    characters: Annotated[int, typer.Option(min=1, max=MOST_CHARACTERS)] = 1,
    max_characters: Annotated[
        bool, typer.Option("--max-characters", help="find how many can be had: hardly a tick missed, no plan late")
    ] = False,
    seconds: Annotated[float, typer.Option(min=1.0)] = 60.0,
    kinds: Annotated[
        KindsOption | None, typer.Option(help="commands of `eval text`, in place of walking, standing and waving")
    ] = None,
    seed: int = 1,
    threads: Threads = 1,
    planner: Planner = None,
    tracker: Tracker = None,
    json: JsonFile = None,
) -> None:
    """Realtime: missed ticks, late plans, how soon a command shows."""
    with console.status("running ...") as status:

        def say(line: str) -> None:
            status.update(line)

        async def measured(services: Services, stack: Stack) -> dict[str, Any]:
            def of(count: int) -> Awaitable[dict[str, Any]]:
                return benches.bench_loop(services, count, seconds, seed, planner, tracker, say, kinds)

            return await (
                benches.most_characters(of, MOST_CHARACTERS, console.print) if max_characters else of(characters)
            )

        result = with_services(measured, planner, tracker, threads)
    write_json(json, {**result, **provenance(seed)})


@bench.command("planner")
def bench_planner(
    repeats: Annotated[int, typer.Option(min=1)] = 5,
    threads: Threads = 1,
    runtime: Annotated[str, typer.Option(help="what runs `full` and `small`: auto, torch or openvino")] = "auto",
    steps: Annotated[int | None, typer.Option(min=1, help="diffusion steps of `small`; default: as in use")] = None,
    without_avx512: Annotated[bool, typer.Option("--without-avx512", help="switch its use off")] = False,
    seed: int = 1,
    json: JsonFile = None,
) -> None:
    """CPU time of a plan: the paper's network written down plainly, as in use, and what ships; and every plug-in."""
    if without_avx512:
        os.environ.update(WITHOUT_AVX512)
    os.environ.update({"OMP_NUM_THREADS": str(threads), "MKL_NUM_THREADS": str(threads)})
    options = ["--repeats", str(repeats), "--threads", str(threads), "--runtime", runtime, "--seed", str(seed)]
    in_process = module_json(
        "planner_service.benchmarks.plan_cost", [*options, *([] if steps is None else ["--steps", str(steps)])]
    )
    wire = with_services(
        lambda services, stack: benches.bench_planner(services, stack.planner.pid, repeats), None, None, threads
    )
    write_json(json, {**in_process, **wire, **provenance(seed)})


@bench.command("tracker")
def bench_tracker(seconds: float = 10.0, seed: int = 1, json: JsonFile = None) -> None:
    """Time of a control tick, in process and, for every tracker there is, over the wire."""
    wire = with_services(lambda services, stack: benches.bench_tracker(services, seconds), None, None, 1)
    in_process = module_json("tracker_service.training.bench", ["--seed", str(seed)])
    write_json(json, {**in_process, **wire, **provenance(seed)})


@bench.command("transport")
def bench_transport(repeats: int = 300, seed: int = 1, json: JsonFile = None) -> None:
    """Round trips of the protocol."""
    result = with_services(lambda services, stack: benches.bench_transport(services, repeats), None, None, 1)
    write_json(json, {**result, **provenance(seed)})
