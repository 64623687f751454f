"""The command `motionloop`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from rich.table import Table

from orchestrator.cli.common import DEFAULT_URL, JsonFile, Token, Url, client, console, for_people, write_json
from orchestrator.cli.delegate import PASS_THROUGH, run_module
from orchestrator.cli.show import follow, table
from shared.errors import InvalidInputError

app = typer.Typer(no_args_is_help=True, add_completion=False, help="Text- and target-driven physical characters.")
data = typer.Typer(no_args_is_help=True, help="Motion corpora.")
train = typer.Typer(no_args_is_help=True, help="Train the planner or the tracker.")
app.add_typer(data, name="data")
app.add_typer(train, name="train")

ServiceName = Literal["planner", "tracker", "orchestrator", "all"]


@app.command(context_settings={"allow_extra_args": True, "ignore_unknown_options": True})
def serve(
    context: typer.Context,
    what: Annotated[ServiceName, typer.Argument(help="one service, or all three")] = "all",
    host: str = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="0 takes a free one")] = 8080,
    planner: Annotated[str | None, typer.Option(help="all: planner plug-in")] = None,
    tracker: Annotated[str | None, typer.Option(help="all: tracker plug-in")] = None,
    data_dir: Annotated[Path, typer.Option(help="all: database and recordings")] = Path("out/data"),
) -> None:
    """Run the services. Options of a single service go through to it (see `python -m planner_service --help`)."""
    from orchestrator.cli.serve import serve_all, serve_one
    from orchestrator.core.supervise import StackOptions

    with for_people():
        if what == "orchestrator":
            given = ["--host", host, "--port", str(port), "--data-dir", str(data_dir)]
            for flag, value in (("--planner", planner), ("--tracker", tracker)):
                given += [] if value is None else [flag, value]
            raise typer.Exit(serve_one(what, [*given, *context.args]))
        if what != "all":
            raise typer.Exit(serve_one(what, context.args))
        options = StackOptions(host, port, planner, tracker, str(data_dir))
        raise typer.Exit(serve_all(options, console))


@app.command()
def demo(
    out: Annotated[Path, typer.Option(help="where the files go")] = Path("out/demo"),
    seed: int = 1,
    planner: Annotated[str | None, typer.Option(help="planner plug-in")] = None,
    tracker: Annotated[str | None, typer.Option(help="tracker plug-in")] = None,
    pacing: Annotated[Literal["lockstep", "realtime"], typer.Option()] = "lockstep",
    video: Annotated[bool, typer.Option(help="render the video")] = True,
    url: Annotated[str | None, typer.Option(help="use the services of this server instead of starting some")] = None,
    token: Token = None,
) -> None:
    """Walk to a point, wave, walk to a point behind, stand still; exit code 0 only if all succeeded."""
    from orchestrator.cli.demo import play_demo, run_demo

    if url is None:
        with for_people():
            raise typer.Exit(0 if run_demo(out, seed, planner, tracker, pacing, console, video) else 1)
    if planner or tracker:
        raise typer.BadParameter("the server's plug-ins are chosen with `motionloop swap`", param_hint="--planner")
    with client(url, token) as http:
        raise typer.Exit(0 if play_demo(http, out, seed, pacing, console, video) else 1)


@app.command()
def say(
    text: Annotated[str, typer.Argument(help="what to do, in words")],
    target: Annotated[str | None, typer.Option(help="x,y,z in metres")] = None,
    joint: Annotated[str, typer.Option(help="which joint goes there; traj is the root on the floor")] = "traj",
    character: Annotated[str | None, typer.Option(help="id; by default the newest, or a new one")] = None,
    url: Url = DEFAULT_URL,
    token: Token = None,
) -> None:
    """Tell a character what to do."""
    with client(url, token) as http:
        if character is None:
            running = [c for c in http.characters() if c.status in ("running", "degraded")]
            character = running[-1].id if running else http.create_character(pacing="realtime").id
        tick = http.command(character, text, _point(target), joint)
        console.print(f"character {character}: taken at tick {tick}", highlight=False)


@app.command()
def episode(
    file: Annotated[Path, typer.Argument(exists=True, dir_okay=False, help="JSON or YAML, as POST /v1/episodes")],
    seed: Annotated[int | None, typer.Option(help="instead of the file's")] = None,
    out: Annotated[Path | None, typer.Option(help="folder for the recording and the video")] = None,
    url: Url = DEFAULT_URL,
    token: Token = None,
    json: JsonFile = None,
) -> None:
    """Run an episode and show how it goes; exit code 0 only if every task succeeded."""
    with client(url, token) as http:
        spec = _read(file)
        if seed is not None:
            spec["seed"] = seed
        episode_id = http.start_episode(spec)
        follow(http.events(episode_id), console)
        result = http.episode(episode_id)
        console.print(table(result))
        if out is not None:
            _fetch(http, episode_id, out, ("npz", "bvh", "csv", "mp4"))
        if json is not None:
            write_json(json, result.model_dump(mode="json"))
        raise typer.Exit(0 if result.success else 1)


@app.command()
def swap(
    kind: Annotated[Literal["planner", "tracker"], typer.Argument()],
    plugin: Annotated[str | None, typer.Option(help="plug-in name")] = None,
    endpoint: Annotated[str | None, typer.Option(help="another service, tcp://HOST:PORT")] = None,
    url: Url = DEFAULT_URL,
    token: Token = None,
) -> None:
    """Exchange the planner or the tracker of a running server."""
    with client(url, token) as http:
        used = http.swap(kind, endpoint, plugin)
        console.print(f"{kind}: {used['plugin']} at {used['endpoint']}", highlight=False)


@app.command()
def export(
    episode_id: Annotated[str, typer.Argument(help="id of an episode that is over")],
    out: Annotated[Path, typer.Option(help="folder")] = Path("out/export"),
    formats: Annotated[str, typer.Option(help="npz, bvh, csv, mp4, with commas")] = "npz,bvh",
    url: Url = DEFAULT_URL,
    token: Token = None,
) -> None:
    """Fetch an episode's motion."""
    with client(url, token) as http:
        _fetch(http, episode_id, out, [name.strip() for name in formats.split(",")])


@app.command()
def conformance(
    endpoint: Annotated[str, typer.Argument(help="tcp://HOST:PORT or ipc://PATH")],
    plugin: Annotated[str | None, typer.Option(help="plug-in; the service's default otherwise")] = None,
) -> None:
    """Check that a planner or tracker service keeps the contract; exit code 0 only if it does."""
    from shared.plugins.conformance import check_planner_endpoint, check_tracker_endpoint
    from shared.protocol.transport import ServiceClient
    from shared.settings import client_curve_keys

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


@data.command("import")
def data_import(
    source: Annotated[Path, typer.Argument(exists=True, help="BVH, ASF + AMC or SMPL npz, or a folder of them")],
    out: Annotated[Path, typer.Argument(help="folder for the retargeted clips")],
) -> None:
    """Bring recorded motion onto the skeleton."""
    from shared.data.importer import import_path

    with for_people():
        entries = import_path(source, out)
    refused = [entry for entry in entries if "error" in entry]
    for entry in refused:
        console.print(f"not imported: {entry['file']}: {entry['error']}", style="yellow", markup=False, highlight=False)
    write_json(None, {"imported": len(entries) - len(refused), "refused": len(refused), "files": entries})
    raise typer.Exit(1 if len(refused) == len(entries) else 0)


@data.command("build")
def data_build(
    mocap: Annotated[Path, typer.Argument(exists=True, file_okay=False, envvar="MOTIONLOOP_MOCAP")],
    out: Annotated[Path, typer.Argument(help="folder of the corpus, replaced as a whole")],
    seed: int = 0,
) -> None:
    """Build the training corpus."""
    from shared.data.build import build

    with for_people(), console.status("building ...") as status:
        command = f"motionloop data build {mocap} {out} --seed {seed}"
        manifest = build(mocap, out, seed, lambda stage, share: status.update(f"{stage} {share:.0%}"), command)
    write_json(None, manifest)


@train.command("planner", context_settings=PASS_THROUGH)
def train_planner(context: typer.Context) -> None:
    """Train DiP; options as of `python -m planner_service.training.main`."""
    run_module("planner_service.training.main", context.args)


@train.command("tracker", context_settings=PASS_THROUGH)
def train_tracker(context: typer.Context) -> None:
    """Train the tracker with PPO; options as of `python -m tracker_service.training.main`."""
    run_module("tracker_service.training.main", context.args)


def _point(text: str | None) -> tuple[float, float, float] | None:
    if text is None:
        return None
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise InvalidInputError(f"target {text!r}", field="target", allowed="x,y,z in metres") from None
    return x, y, z


def _read(file: Path) -> dict[str, Any]:
    text = file.read_text()
    if file.suffix in (".yaml", ".yml"):
        import yaml

        spec = yaml.safe_load(text)
    else:
        try:
            spec = json.loads(text)
        except json.JSONDecodeError as error:
            raise InvalidInputError(f"{file} is no JSON: {error}", field="file", allowed="JSON or YAML") from error
    if not isinstance(spec, dict):
        raise InvalidInputError(f"{file} holds no episode", field="file", allowed="an object with `tasks`")
    return spec


def _fetch(http: Any, episode_id: str, out: Path, formats: list[str] | tuple[str, ...]) -> None:
    out.mkdir(parents=True, exist_ok=True)
    for suffix in formats:
        path = out / f"{episode_id}.{suffix}"
        path.write_bytes(http.video(episode_id) if suffix == "mp4" else http.motion(episode_id, suffix))
        console.print(f"written: {path}", highlight=False)


def _add_measurements() -> None:
    """eval and bench need the server's packages; the light client goes without them."""
    try:
        from orchestrator.cli.measure import bench, evaluate
    except ModuleNotFoundError:
        return
    app.add_typer(evaluate, name="eval")
    app.add_typer(bench, name="bench")


def main() -> None:
    """Entry point."""
    _add_measurements()
    app()


if __name__ == "__main__":
    main()
