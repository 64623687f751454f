"""What a person may say about a motion file that the file does not say itself."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from shared.errors import InvalidInputError
from shared.motion.io.axes import TURNS
from shared.motion.io.landmarks import MARKS

SLOWEST_HZ, FASTEST_HZ = 5.0, 1000.0
ASSUMED_HZ = 30.0
RATES = f"{SLOWEST_HZ:g} to {FASTEST_HZ:g} frames per second"


@dataclass(frozen=True)
class ReadOptions:
    """How to read motion files; None and 'auto' leave it to the file, or to what can be seen in it.

    Attributes:
        fps: frames per second, in place of what the file says.
        up: the vertical axis: 'auto', 'x', 'y' or 'z' (also with a minus).
        unit_m: metres in one unit of the file.
        joints: our joint names to the file's, for skeletons whose names are not known.
        root: name of the root to read where a file has several, such as two people.
    """

    fps: float | None = None
    up: str = "auto"
    unit_m: float | None = None
    joints: Mapping[str, str] | None = None
    root: str | None = None

    def __post_init__(self) -> None:
        if self.fps is not None and not SLOWEST_HZ <= self.fps <= FASTEST_HZ:
            raise InvalidInputError(f"a rate of {self.fps:g} frames per second", field="fps", allowed=RATES)
        if self.up != "auto" and self.up not in TURNS:
            raise InvalidInputError(f"unknown up axis {self.up!r}", field="up", allowed=f"auto, {', '.join(TURNS)}")
        if self.unit_m is not None and not (math.isfinite(self.unit_m) and self.unit_m > 0):
            raise InvalidInputError(f"a unit of {self.unit_m} m", field="unit", allowed="> 0 metres")


def rate_of(
    name: str, said: float | None, options: ReadOptions, wording: str = "the file says"
) -> tuple[float, list[str]]:
    """Frames per second of a file and what to say about it.

    Args:
        name: the file, for messages.
        said: what the file says, None where it says nothing.
        options: `fps` goes before the file.
        wording: how the file says it, for the message.

    Raises:
        InvalidInputError: the file's rate is none, or none a recording has, and no other was given.
    """
    usual = said is not None and math.isfinite(said) and SLOWEST_HZ <= said <= FASTEST_HZ
    if options.fps is not None:
        if said is None or (usual and abs(said / options.fps - 1) < 2e-3):
            return options.fps, []
        return options.fps, [f"{wording} {said:.4g} frames per second; read at {options.fps:g} as asked"]
    if said is None:
        return ASSUMED_HZ, [
            f"no frame rate in the file: {ASSUMED_HZ:g} frames per second assumed (--fps says otherwise)"
        ]
    if not usual:
        raise InvalidInputError(
            f"{name}: {wording} {said:.4g} frames per second, which no recording has (give the right one with --fps)",
            field="fps",
            allowed=RATES,
        )
    # A rate within 0.2 % of a whole number is that number: files round the frame time.
    return (float(round(said)) if abs(said - round(said)) / said < 2e-3 else said), []


def read_joint_map(path: str | Path) -> dict[str, str]:
    """A map of our joint names to a file's: a JSON object such as {"left_hip": "Bone_12"}.

    Raises:
        InvalidInputError: it cannot be read, or is no object of names.
    """
    path = Path(path)
    try:
        data = json.loads(path.read_text(encoding="utf-8-sig"))
    except (OSError, ValueError) as error:
        raise InvalidInputError(f"{path}: no joint map can be read there ({error})", field="joints") from error
    if not isinstance(data, dict) or not all(isinstance(v, str) for v in data.values()):
        raise InvalidInputError(
            f"{path}: a joint map is a JSON object of our joint names to the file's",
            field="joints",
            allowed=", ".join(MARKS),
        )
    return data
