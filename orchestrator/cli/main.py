"""The command `motionloop`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
import typer.core
from rich.table import Table

from orchestrator.cli.common import Token, client, console, for_people
from orchestrator.cli.data import data_build, data_import
from orchestrator.cli.delegate import PASS_THROUGH, need, run_module, say_what_is_missing
from orchestrator.cli.talk import episode, export, say, swap, watch
from orchestrator.cli.top import top
from shared.console import errors_for_people

INTERRUPTED = 130
"""Exit code after Ctrl-C, as shells have it."""


class _Quiet(typer.core.TyperGroup):
    """Ends without a word on Ctrl-C."""

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            raise typer.Exit(INTERRUPTED) from None


app = typer.Typer(
    cls=_Quiet, no_args_is_help=True, add_completion=False, help="Text- and target-driven physical characters."
)
data = typer.Typer(no_args_is_help=True, help="Motion corpora.")
train = typer.Typer(no_args_is_help=True, help="Train the planner or the tracker.")
app.add_typer(data, name="data")
app.add_typer(train, name="train")

ServiceName = Literal["planner", "tracker", "orchestrator", "all"]
NEEDED = {
    "planner": ("zmq",),
    "tracker": ("mujoco",),
    "orchestrator": ("uvicorn",),
    "all": ("uvicorn", "mujoco", "scipy"),
}
LIGHT = ("say", "episode", "swap", "export", "watch", "top", "conformance", "serve", "demo", "train")
"""Commands that need nothing of `eval`, `bench` and `data bank`."""


@app.command(context_settings={"allow_extra_args": True, "ignore_unknown_options": True})
def serve(
    context: typer.Context,
    what: Annotated[ServiceName, typer.Argument(help="one service, or all three")] = "all",
    host: str = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="0 takes a free one")] = 8080,
    planner: Annotated[str | None, typer.Option(help="all: planner plug-in")] = None,
    tracker: Annotated[str | None, typer.Option(help="all: tracker plug-in")] = None,
    data_dir: Annotated[Path, typer.Option(help="all: database and recordings")] = Path("out/data"),
    scenes: Annotated[Path | None, typer.Option(help="orchestrator, all: folder of your own scenes (YAML)")] = None,
) -> None:
    """Run the services. Options of a single service go through to it (see `python -m planner_service --help`)."""
    need(*NEEDED[what])
    from orchestrator.cli.serve import serve_all, serve_one
    from orchestrator.core.supervise import StackOptions

    with for_people():
        if what == "orchestrator":
            given = ["--host", host, "--port", str(port), "--data-dir", str(data_dir)]
            for flag, value in (("--planner", planner), ("--tracker", tracker), ("--scenes", scenes)):
                given += [] if value is None else [flag, str(value)]
            raise typer.Exit(serve_one(what, [*given, *context.args]))
        if what != "all":
            raise typer.Exit(serve_one(what, context.args))
        options = StackOptions(host, port, planner, tracker, str(data_dir), None if scenes is None else str(scenes))
        raise typer.Exit(serve_all(options, console))


@app.command()
def demo(
    out: Annotated[Path, typer.Option(help="where the files go")] = Path("out/demo"),
    seed: int = 1,
    planner: Annotated[str | None, typer.Option(help="planner plug-in")] = None,
    tracker: Annotated[str | None, typer.Option(help="tracker plug-in")] = None,
    pacing: Annotated[Literal["lockstep", "realtime"], typer.Option()] = "lockstep",
    video: Annotated[bool, typer.Option(help="render the video")] = True,
    episode_file: Annotated[
        Path | None, typer.Option("--episode", exists=True, dir_okay=False, help="another episode (JSON or YAML)")
    ] = None,
    url: Annotated[str | None, typer.Option(help="use the services of this server instead of starting some")] = None,
    token: Token = None,
) -> None:
    """Walk to a point, wave, walk to a point behind, stand still; exit code 0 only if all succeeded."""
    from orchestrator.cli.demo import play_demo, run_demo
    from orchestrator.cli.talk import read_episode

    with for_people():
        spec = None if episode_file is None else read_episode(episode_file)
    if url is None:
        need(*NEEDED["all"])
        with for_people():
            raise typer.Exit(0 if run_demo(out, seed, planner, tracker, pacing, console, video, spec) else 1)
    if planner or tracker:
        raise typer.BadParameter("the server's plug-ins are chosen with `motionloop swap`", param_hint="--planner")
    with client(url, token) as http:
        raise typer.Exit(0 if play_demo(http, out, seed, pacing, console, video, spec) else 1)


for _command in (say, episode, swap, export, watch, top):
    app.command()(_command)


@app.command()
def conformance(
    endpoint: Annotated[str, typer.Argument(help="tcp://HOST:PORT or ipc://PATH")],
    plugin: Annotated[str | None, typer.Option(help="plug-in; the service's default otherwise")] = None,
) -> None:
    """Check that a planner or tracker service keeps the contract; exit code 0 only if it does."""
    from shared.plugins.conformance import check_planner_endpoint, check_tracker_endpoint
    from shared.protocol.security import client_curve_keys
    from shared.protocol.transport import ServiceClient

    with for_people():
        curve = client_curve_keys()
        with ServiceClient(endpoint, curve=curve, name="conformance") as peer:
            kind = peer.connect().service
        check = check_planner_endpoint if kind == "planner" else check_tracker_endpoint
        results = check(endpoint, plugin, curve=curve)
    rows = Table(title=f"{kind} at {endpoint}")
    for column in ("check", "passed", "detail"):
        rows.add_column(column)
    for result in results:
        rows.add_row(result.name, "[green]yes[/green]" if result.passed else "[red]no[/red]", result.detail)
    console.print(rows)
    raise typer.Exit(0 if all(result.passed for result in results) else 1)


data.command("import")(data_import)
data.command("build")(data_build)


@train.command("planner", context_settings=PASS_THROUGH)
def train_planner(context: typer.Context) -> None:
    """Train DiP; options as of `python -m planner_service.training.main`."""
    run_module("planner_service.training.main", context.args)


@train.command("tracker", context_settings=PASS_THROUGH)
def train_tracker(context: typer.Context) -> None:
    """Train the tracker through a model of its body; options as of `python -m tracker_service.training.world.main`.

    With --ppo plain PPO, which it is compared with: `python -m tracker_service.training.main`.
    """
    arguments = [a for a in context.args if a != "--ppo"]
    ppo = len(arguments) < len(context.args)
    run_module("tracker_service.training.main" if ppo else "tracker_service.training.world.main", arguments)


def _add_measurements() -> None:
    """Commands that need the server's packages; without them each says how to get them."""
    try:
        from orchestrator.cli.bank import data_bank
        from orchestrator.cli.measure import bench, evaluate
    except ModuleNotFoundError as error:
        missing = str(error.name)

        def refuse(context: typer.Context) -> None:
            say_what_is_missing(missing)

        for name in ("eval", "bench"):
            app.command(name, help="Needs pip install 'motionloop[all]'.", context_settings=PASS_THROUGH)(refuse)
        return
    app.add_typer(evaluate, name="eval")
    app.add_typer(bench, name="bench")
    data.command("bank")(data_bank)


def main() -> None:
    """Entry point."""
    if sys.argv[1:2] == [] or sys.argv[1] not in LIGHT:  # the others start quicker without what only these need
        _add_measurements()
    with errors_for_people():  # what no command has told yet
        app()


if __name__ == "__main__":
    main()
