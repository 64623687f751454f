"""Commands that talk to a running server: say, episode, swap, export, watch."""

from __future__ import annotations

import json as jsonlib
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated, Any, Literal, cast

import typer
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from orchestrator.cli.common import JsonFile, Token, Url, client, console, write_json
from orchestrator.cli.show import Follower, notes, table
from orchestrator.client import Character, Client, Episode, ServicesInfo
from orchestrator.client.calls import DEFAULT_URL, FORMATS, Format
from shared.errors import InvalidInputError, NotFoundError

CharacterOption = Annotated[str | None, typer.Option("--character", help="id; by default the newest")]
BvhUnit = Annotated[Literal["m", "cm"], typer.Option(help="length unit of BVH; m is to scale in Blender")]


def say(
    text: Annotated[str, typer.Argument(help="what to do, in words")],
    target: Annotated[str | None, typer.Option(help="x,y,z in metres; x,y is enough for traj")] = None,
    joint: Annotated[str, typer.Option(help="which joint goes there; traj is the root on the floor")] = "traj",
    character: Annotated[str | None, typer.Option(help="id; by default the newest, or a new one")] = None,
    watch: Annotated[bool, typer.Option("--watch", help="show what it does, until Ctrl-C")] = False,
    url: Url = DEFAULT_URL,
    token: Token = None,
    json: JsonFile = None,
) -> None:
    """Tell a character what to do."""
    with client(url, token) as server:
        point = _point(target)
        chosen = server.characters.get(character) if character else _newest(server) or server.character()
        taken = chosen.tell(text) if point is None else chosen.tell(text, target=point, joint=joint)
        console.print(f"character {chosen.id}: taken at tick {taken.tick}", highlight=False)
        for line in notes(taken):
            console.print(line, style="yellow", markup=False, highlight=False)
        if json is not None:
            given = {"character": chosen.id, "text": text, "target": point, "joint": joint}
            write_json(json, {**given, **taken.model_dump(mode="json")})
        if watch:
            _watch(chosen, None, None)


def episode(
    file: Annotated[Path, typer.Argument(exists=True, dir_okay=False, help="JSON or YAML, as POST /v1/episodes")],
    seed: Annotated[int | None, typer.Option(help="instead of the file's")] = None,
    out: Annotated[Path | None, typer.Option(help="folder for the recording and the video")] = None,
    url: Url = DEFAULT_URL,
    token: Token = None,
    json: JsonFile = None,
) -> None:
    """Run an episode and show how it goes; exit code 0 only if every task succeeded."""
    with client(url, token) as server:
        spec = read_episode(file)
        if seed is not None:
            spec["seed"] = seed
        run = server.episode(spec.pop("tasks", []), **cast("Any", spec))
        console.print(f"episode {run.id}", highlight=False)
        with Follower(console) as follower:
            try:
                result = run.wait(on_event=follower.take)
            except KeyboardInterrupt:
                run.cancel()
                console.print(f"cancelled; what was recorded: motionloop export {run.id}", highlight=False)
                raise typer.Exit(130) from None
        console.print(table(result))
        if out is not None:
            _fetch(run, out, FORMATS)
        if json is not None:
            write_json(json, result.model_dump(mode="json"))
        raise typer.Exit(0 if result.success else 1)


def swap(
    kind: Annotated[Literal["planner", "tracker"] | None, typer.Argument(help="nothing shows what is in use")] = None,
    plugin: Annotated[str | None, typer.Option(help="plug-in name")] = None,
    endpoint: Annotated[str | None, typer.Option(help="another service, tcp://HOST:PORT")] = None,
    url: Url = DEFAULT_URL,
    token: Token = None,
    json: JsonFile = None,
) -> None:
    """Exchange the planner or the tracker of a running server; without arguments, show both."""
    with client(url, token) as server:
        if kind is None:
            console.print(_services(server.services()))
        else:
            new = server.swap(kind, plugin, endpoint=endpoint)
            console.print(f"{kind}: {new.plugin} at {new.endpoint}", highlight=False)
        if json is not None:
            write_json(json, server.services().model_dump(mode="json"))


def export(
    episode_id: Annotated[str, typer.Argument(help="id of an episode that is over, or `last`")] = "last",
    out: Annotated[Path, typer.Option(help="folder")] = Path("out/export"),
    formats: Annotated[str, typer.Option(help="npz, bvh, csv, glb, mp4, with commas")] = "npz,bvh",
    unit: BvhUnit = "m",
    url: Url = DEFAULT_URL,
    token: Token = None,
    json: JsonFile = None,
) -> None:
    """Fetch an episode's motion as files."""
    with client(url, token) as server:
        wanted = _formats(formats)
        found = _last(server) if episode_id == "last" else server.episodes.get(episode_id)
        files = _fetch(found, out, wanted, unit)
        if json is not None:
            write_json(json, {"episode": found.id, "files": [str(path) for path in files]})


def watch(
    character: CharacterOption = None,
    seconds: Annotated[float | None, typer.Option(min=0.1, help="end after so long; default: until Ctrl-C")] = None,
    url: Url = DEFAULT_URL,
    token: Token = None,
    json: Annotated[Path | None, typer.Option("--json", help="write every state to this file, a line each")] = None,
) -> None:
    """Show a running character in the terminal: pose from the side and above, state, command, plan latency."""
    with client(url, token) as server:
        chosen = server.characters.get(character) if character else _newest(server)
        if chosen is None:
            raise NotFoundError('there is no character: make one with `motionloop say "a person walks"`')
        _watch(chosen, seconds, json)


def _watch(character: Character, seconds: float | None, json: Path | None) -> None:
    from orchestrator.cli.watch import watch as show

    if json is not None:
        json.parent.mkdir(parents=True, exist_ok=True)
    with json.open("w") if json is not None else nullcontext() as lines:
        show(character, console, seconds, lines)


def _newest(server: Client) -> Character | None:
    running = [info for info in server.characters.all() if info.status in ("running", "degraded", "paused")]
    return server.characters.get(running[-1].id) if running else None


def _last(server: Client) -> Episode:
    over = [info for info in server.episodes.all(limit=50) if info.status != "running"]
    if not over:
        raise NotFoundError("no episode is over yet: run one with `motionloop episode FILE`")
    return server.episodes.get(over[0].id)


def _services(used: ServicesInfo) -> Table:
    rows = Table(title="services in use")
    for column in ("service", "plug-in", "offers", "endpoint", "version"):
        rows.add_column(column)
    for kind, info in (("planner", used.planner), ("tracker", used.tracker)):
        rows.add_row(kind, info.plugin, ", ".join(info.plugins), info.endpoint, info.version)
    return rows


def _point(text: str | None) -> tuple[float, ...] | None:
    if text is None:
        return None
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) not in (2, 3):
        raise InvalidInputError(f"target {text!r}", field="target", allowed="x,y,z in metres, or x,y for traj")
    return numbers


def _formats(text: str) -> list[Format]:
    names = [name.strip() for name in text.split(",") if name.strip()]
    for name in names:
        if name not in FORMATS:
            raise InvalidInputError(f"there is no format {name!r}", field="formats", allowed=", ".join(FORMATS))
    return [kind for kind in FORMATS if kind in names]


def read_episode(file: Path) -> dict[str, Any]:
    """An episode as POST /v1/episodes takes it, from a file; raises InvalidInputError where it is no such thing."""
    text = file.read_text()
    if file.suffix in (".yaml", ".yml"):
        import yaml

        try:
            spec = yaml.safe_load(text)
        except yaml.YAMLError as error:
            raise InvalidInputError(f"{file} is no YAML: {error}", field="file", allowed="JSON or YAML") from error
    else:
        try:
            spec = jsonlib.loads(text)
        except jsonlib.JSONDecodeError as error:
            raise InvalidInputError(f"{file} is no JSON: {error}", field="file", allowed="JSON or YAML") from error
    if not isinstance(spec, dict):
        raise InvalidInputError(f"{file} holds no episode", field="file", allowed="an object with `tasks`")
    return spec


def _fetch(run: Episode, out: Path, formats: Sequence[Format], unit: Literal["m", "cm"] = "m") -> list[Path]:
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    files = []
    with Progress(*columns, console=console, transient=True) as progress:
        for kind in formats:
            task = progress.add_task("rendering the video" if kind == "mp4" else f"fetching {kind}", total=None)
            files.append(run.save(out / f"{run.id}.{kind}", unit))
            progress.remove_task(task)
            console.print(f"written: {files[-1]} ({files[-1].stat().st_size / 1024:.0f} KiB)", highlight=False)
    return files
