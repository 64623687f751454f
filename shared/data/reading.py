"""Many motion files one after the other: what each gave, what was assumed, and which could not be read."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from shared.console import EXPECTED, as_ours
from shared.data.grounding import Quality, ground
from shared.data.retarget import Calibration, calibrate, retarget
from shared.data.splice import denoise
from shared.errors import InvalidInputError
from shared.motion.body import Array, origin_start
from shared.motion.clip import MotionClip
from shared.motion.ik import clip_from_positions
from shared.motion.io.axes import unit_name, upright_share
from shared.motion.io.files import read_motion
from shared.motion.io.options import ReadOptions
from shared.motion.io.raw import LeftOutError
from shared.protocol.rates import CORPUS_FPS as FPS

_REST_JUMP_M = 0.25
_LEAST_FRAMES = 4
_UNEVEN_M = 0.35
_FASTEST_MPS = 15.0
_SELDOM = 0.02
DEGENERATE = (ValueError, ArithmeticError, IndexError, np.linalg.LinAlgError)
"""What numerics raise on a skeleton that is none, such as one with all joints in one place."""


@dataclass(frozen=True)
class Loaded:
    """A recording as a clip of the canonical skeleton, and how it was read.

    Attributes:
        clip: at 30 fps, on the floor, starting over the origin facing +X; quality: how well it stands there.
        frames, fps, up, unit_m, family: of the file; see `RawMotion`.
        travelled_m: way of the pelvis over the floor in the clip.
        warnings: what was assumed or passed over, in sentences.
    """

    clip: MotionClip
    quality: Quality
    frames: int
    fps: float
    up: str
    unit_m: float
    family: str
    travelled_m: float
    warnings: tuple[str, ...]

    @property
    def seconds(self) -> float:
        """Length of the recording."""
        return self.frames / self.fps

    def as_dict(self) -> dict[str, Any]:
        return {
            "frames": self.frames,
            "fps": self.fps,
            "seconds": round(self.seconds, 3),
            "up": self.up,
            "unit_m": self.unit_m,
            "skeleton": self.family,
            "travelled_m": round(self.travelled_m, 3),
            "warnings": list(self.warnings),
            "quality": self.quality.as_dict(),
        }


@dataclass(frozen=True)
class Outcome:
    """What came of a file: `loaded`, or why it was `left_out`, or the `error` that kept it from being read."""

    file: Path
    label: str
    loaded: Loaded | None = None
    left_out: str = ""
    error: str = ""

    def as_dict(self) -> dict[str, Any]:
        row: dict[str, Any] = {"file": str(self.file)}
        if self.loaded is not None:
            return row | self.loaded.as_dict()
        return row | ({"left_out": self.left_out} if self.left_out else {"error": self.error})

    def lines(self, then: str = "") -> list[str]:
        """A row for people, and a line for each warning; `then`: what the row ends with."""
        if self.loaded is None:
            return [f"warning: {self.label}: left out: {self.left_out}" if self.left_out else self.error_line()]
        x = self.loaded
        cells = row(self.label, x.fps, x.seconds, x.up, x.unit_m, x.family, x.travelled_m)
        return [cells + _shown(then), *(f"warning: {self.label}: {warning}" for warning in x.warnings)]

    def error_line(self) -> str:
        return f"error: {self.label}: {self.error}"


def row(label: str, fps: float, seconds: float, up: str, unit_m: float, family: str, way_m: float) -> str:
    """How a file was read, in a line."""
    cells = (label, f"{fps:g} fps", f"{seconds:.2f} s", f"up {up.upper()}", f"unit {unit_name(unit_m)}",
             f"skeleton {family}", f"travelled {way_m:.2f} m")  # fmt: skip
    return "  ".join(cells)


def travelled_m(positions: Array) -> float:
    """Way of the pelvis over the floor, in steps of a sixth of a second so that swaying and noise count little."""
    path = positions[np.unique(np.append(np.arange(0, len(positions), 5), len(positions) - 1)), 0, :2]
    return float(np.linalg.norm(np.diff(path, axis=0), axis=-1).sum())


def load(path: str | Path, options: ReadOptions | None = None, calibration: Calibration | None = None) -> Loaded:
    """Read a recording and bring it onto the canonical skeleton.

    Raises:
        LeftOutError: it is shorter than four frames, or holds no motion.
        InvalidInputError: it cannot be read.
    """
    raw = read_motion(path, options)
    if len(raw) < _LEAST_FRAMES:
        raise LeftOutError(f"{Path(path).name}: {len(raw)} frames are too few", field="path", allowed=">= 4")
    positions = retarget(raw, calibration if calibration is not None else calibrate([raw]))
    if len(positions) > 3 and np.linalg.norm(positions[1] - positions[0], axis=-1).max() > _REST_JUMP_M:
        positions = positions[1:]  # many BVH files begin with their zero pose
    positions, quality = ground(denoise(positions))
    said = list(raw.warnings)
    if quality.height_spread_m > _UNEVEN_M:
        said.append(
            f"the ground under it differs by {quality.height_spread_m:.2f} m: uneven ground, or a wrong axis or unit "
            "(--up, --unit)"
        )
    if upright_share(raw.positions_w_m, raw.landmarks()) < _SELDOM:
        said.append("the body is hardly ever upright: it lies or crawls, or another axis is up (--up)")
    if quality.max_joint_speed_mps > _FASTEST_MPS:
        said.append(f"a joint moves at {quality.max_joint_speed_mps:.0f} m/s: broken frames, or a wrong rate or unit")
    clip = clip_from_positions(origin_start(positions), FPS, rebuild=True)
    way = travelled_m(clip.positions_w_m)
    return Loaded(clip, quality, len(raw), raw.fps, raw.up, raw.unit_m, raw.family, way, tuple(said))


def read_all(files: Sequence[Path], root: Path, options: ReadOptions | None = None) -> Iterator[Outcome]:
    """What comes of each file, in order; a bad one does not end it. `root`: where the names shown begin."""
    for file in files:
        label = _shown(str(file.relative_to(root)) if root in file.parents else file.name)
        try:
            yield Outcome(file, label, loaded=load(file, options))
        except LeftOutError as error:
            yield Outcome(file, label, left_out=_without_name(error, file))
        except EXPECTED as error:
            yield Outcome(file, label, error=_without_name(as_ours(error), file))
        except DEGENERATE as error:
            yield Outcome(file, label, error=f"no person can be made of it ({error})")


def _shown(name: str) -> str:
    """A file's name in one line of text that any output takes: line breaks and bytes that are no text are escaped."""
    return name if name.isprintable() else ascii(name)[1:-1]


def _without_name(error: InvalidInputError | Exception, file: Path) -> str:
    """The message, which begins with the file's name, without it."""
    return str(error).removeprefix(f"{file.name}: ")


def summary(outcomes: Sequence[Outcome], done: str = "read") -> str:
    """'3 read, 1 left out, 1 could not be read'."""
    left_out = sum(bool(o.left_out) for o in outcomes)
    errors = sum(bool(o.error) for o in outcomes)
    parts = [f"{len(outcomes) - left_out - errors} {done}"]
    parts += [f"{left_out} left out"] if left_out else []
    parts += [f"{errors} could not be read"] if errors else []
    return ", ".join(parts)
