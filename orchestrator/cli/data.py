"""`motionloop data import`, `motionloop data build`: recorded motion comes in."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from orchestrator.cli.common import JsonFile, console, for_people, provenance, save_json
from orchestrator.cli.delegate import need
from shared.console import EXPECTED, as_ours

if TYPE_CHECKING:
    from shared.motion.io.options import ReadOptions

Fps = Annotated[float | None, typer.Option(help="frames per second of the files, in place of what they say")]
UpAxis = Annotated[str, typer.Option(help="vertical axis of the files: x, y or z; auto finds it")]
Unit = Annotated[float | None, typer.Option(metavar="METRES", help="metres in one unit of the files")]
Joints = Annotated[Path | None, typer.Option(metavar="FILE", help="JSON of our joint names to the files'")]
Root = Annotated[str | None, typer.Option(metavar="NAME", help="which of several roots of a BVH, e.g. of two people")]


def read_options(fps: float | None, up: str, unit: float | None, joints: Path | None, root: str | None) -> ReadOptions:
    """The options as the readers take them."""
    from shared.motion.io.options import ReadOptions, read_joint_map

    return ReadOptions(fps, up.lower(), unit, read_joint_map(joints) if joints is not None else None, root)


def data_import(
    source: Annotated[Path, typer.Argument(exists=True, help="BVH, ASF + AMC or SMPL npz, or a folder of them")],
    out: Annotated[Path, typer.Argument(help="folder for the retargeted clips")],
    fps: Fps = None,
    up: UpAxis = "auto",
    unit: Unit = None,
    joints: Joints = None,
    root: Root = None,
    json: JsonFile = None,
) -> None:
    """Bring recorded motion onto the skeleton; exit code 1 if a file cannot be read."""
    need("scipy")
    from shared.data.importer import import_path
    from shared.data.reading import Outcome, summary

    outcomes: list[Outcome] = []

    def row(outcome: Outcome, name: str) -> None:
        outcomes.append(outcome)
        for line in outcome.lines(f"  -> {name}" if name else ""):
            typer.echo(line)

    with for_people():
        entries: list[dict[str, Any]] = []
        try:
            entries = import_path(source, out, read_options(fps, up, unit, joints, root), row)
        except EXPECTED as error:
            save_json(json, {**_counted(entries), "error": as_ours(error).message, **provenance()})
            raise
        result = _counted(entries)
        save_json(json, {**result, **provenance()})
    typer.echo(summary(outcomes, "imported"))
    raise typer.Exit(1 if result["refused"] else 0)


def data_build(
    mocap: Annotated[Path, typer.Argument(exists=True, file_okay=False, envvar="MOTIONLOOP_MOCAP")],
    out: Annotated[Path, typer.Argument(help="folder of the corpus, replaced as a whole")],
    seed: int = 0,
    fps: Fps = None,
    up: UpAxis = "auto",
    unit: Unit = None,
    joints: Joints = None,
    root: Root = None,
    json: JsonFile = None,
) -> None:
    """Build the training corpus from any folder of recordings; exit code 1 if a file cannot be read.

    A folder called after a behaviour (walk, kick, ...) says what its files are, and a text file beside a recording has
    sentences for it; what nothing is said of is labelled by its motion.
    """
    need("scipy")
    from shared.data.build import build

    with for_people():
        lines: list[str] = []
        try:
            with console.status("building ...") as status:
                command = f"motionloop data build {mocap} {out} --seed {seed}"
                manifest = build(
                    mocap, out, seed, lambda stage, share: status.update(f"{stage} {share:.0%}"), command,
                    options=read_options(fps, up, unit, joints, root), say=lines.append,
                )  # fmt: skip
        except EXPECTED as error:
            save_json(json, {"clips": 0, "error": as_ours(error).message, "files": lines, **provenance(seed)})
            raise
        finally:
            for line in lines:
                typer.echo(line)
        save_json(json, manifest)
    errors = len(manifest["errors"])
    unread = f", {errors} files could not be read" if errors else ""
    typer.echo(f"{manifest['clips']} clips, {manifest['minutes']:.1f} min in {out} (see manifest.json){unread}")
    raise typer.Exit(1 if errors else 0)


def _counted(entries: list[dict[str, Any]]) -> dict[str, Any]:
    refused = sum("error" in entry for entry in entries)
    left_out = sum("left_out" in entry for entry in entries)
    imported = len(entries) - refused - left_out
    return {"imported": imported, "left_out": left_out, "refused": refused, "files": entries}
