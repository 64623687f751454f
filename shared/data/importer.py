"""`motionloop data import`: recordings of any skeleton with legs, retargeted to the canonical one."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from shared.console import as_ours
from shared.data.grounding import Quality
from shared.data.reading import Loaded, Outcome, load, read_all
from shared.data.retarget import Calibration
from shared.errors import InvalidInputError
from shared.motion.clip import MotionClip
from shared.motion.io.bvh import write_bvh
from shared.motion.io.files import motion_files
from shared.motion.io.options import ReadOptions
from shared.motion.io.smpl import MOST_BYTES
from shared.npz import read_npz_file

_SUFFIXES = (".npz", ".bvh")
Row = Callable[[Outcome, str], None]
"""Called with what came of each file and the name of its outputs."""


def load_clip(
    path: str | Path, calibration: Calibration | None = None, options: ReadOptions | None = None
) -> tuple[MotionClip, Quality]:
    """A recording as a clip of the canonical skeleton at 30 fps, on the floor, starting over the origin facing +X.

    Raises:
        InvalidInputError: it cannot be read, or is shorter than four frames.
    """
    loaded = load(path, options, calibration)
    return loaded.clip, loaded.quality


def no_row(outcome: Outcome, name: str) -> None:
    """A `Row` that shows nothing."""


def import_path(
    path: str | Path, out: str | Path, options: ReadOptions | None = None, row: Row = no_row
) -> list[dict[str, Any]]:
    """Import a file, or all motion files below a folder.

    Each becomes `<out>/<name>.npz` (positions_w_m, rotations_6d, fps, source) and `<out>/<name>.bvh`. No output takes
    the place of a file that is imported, nor of what came of another one; importing a file again replaces its own.

    Args:
        options: what the files do not say; row: told of each file.

    Returns:
        One entry a file: `file`, `outputs` and how it was read, or `left_out` or `error` with the reason.

    Raises:
        InvalidInputError: nothing to import at `path`.
        OSError: the folder `out` cannot be made.
    """
    path, out = Path(path), Path(out)
    files = motion_files(path, but_not=out)
    out.mkdir(parents=True, exist_ok=True)
    names = _Names(out, files)
    entries: list[dict[str, Any]] = []
    for outcome in read_all(files, path, options):
        name, entry = "", outcome.as_dict()
        if outcome.loaded is not None:
            file = outcome.file
            wanted = file.stem if path.is_file() else "_".join(file.relative_to(path).with_suffix("").parts)
            name = names.take(file, wanted)
            if name != wanted:
                said = f"{wanted} is taken, so it is written as {name}"
                outcome = replace(outcome, loaded=_warned(outcome.loaded, said))
            try:
                _write(out, name, outcome.loaded, file)
                entry = outcome.as_dict() | {"outputs": [str(out / f"{name}{suffix}") for suffix in _SUFFIXES]}
            except OSError as error:
                outcome = Outcome(file, outcome.label, error=f"it cannot be written: {as_ours(error).message}")
                entry = outcome.as_dict()
        entries.append(entry)
        row(outcome, name)
    return entries


def _warned(loaded: Loaded | None, said: str) -> Loaded:
    assert loaded is not None
    return replace(loaded, warnings=(*loaded.warnings, said))


class _Names:
    """Names of outputs; upper and lower case are the same, as they are on some file systems."""

    def __init__(self, out: Path, inputs: Sequence[Path]):
        self._out = out
        self._inputs = {str(p.resolve()).casefold() for p in inputs}
        self._used: set[str] = set()

    def take(self, file: Path, wanted: str) -> str:
        """A free name for what comes of `file`: the wanted one, or with the file's type, or with a number."""
        typed = f"{wanted}_{file.suffix[1:].lower()}"
        for name in itertools.chain((wanted, typed), (f"{typed}_{k}" for k in itertools.count(2))):
            if name.casefold() not in self._used and self._free(name, file):
                self._used.add(name.casefold())
                return name
        raise AssertionError("counting does not end")

    def _free(self, name: str, file: Path) -> bool:
        targets = [self._out / f"{name}{suffix}" for suffix in _SUFFIXES]
        if any(str(target.resolve()).casefold() in self._inputs for target in targets):
            return False
        return not any(target.exists() for target in targets) or _made_from(targets[0]) == str(file.resolve())


def _made_from(clip: Path) -> str:
    """The recording an imported clip was made from, '' where it is none."""
    try:
        return str(read_npz_file(clip, ("source",), MOST_BYTES)[1]["source"])
    except (InvalidInputError, KeyError):
        return ""


def _write(out: Path, name: str, loaded: Loaded | None, file: Path) -> None:
    """Both files, each in place only when it is whole."""
    assert loaded is not None
    clip = loaded.clip
    parts = [out / f".{name}.part{suffix}" for suffix in _SUFFIXES]
    try:
        np.savez_compressed(
            parts[0],
            positions_w_m=clip.positions_w_m.astype(np.float32),
            rotations_6d=clip.rotations_6d.astype(np.float32),
            fps=np.float32(clip.fps),
            source=np.array(str(file.resolve())),
        )
        write_bvh(parts[1], clip)
        for part, suffix in zip(parts, _SUFFIXES, strict=True):
            os.replace(part, out / f"{name}{suffix}")
    finally:
        for part in parts:
            part.unlink(missing_ok=True)
