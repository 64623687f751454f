"""The text of a BVH file: its hierarchy, its header and its rows, with the line of whatever cannot be read."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn

import numpy as np

from shared.errors import InvalidInputError
from shared.motion.io.landmarks import Array
from shared.motion.io.text import number, numbers, read_lines

MAX_FRAMES = 1_000_000
_FRAMES = re.compile(r"^\s*frames\s*:?\s*(\S.*)?$", re.IGNORECASE)
_FRAME_TIME = re.compile(r"^\s*frame\s*time\s*:?\s*(\S.*)?$", re.IGNORECASE)
_KEYWORDS = ("ROOT", "JOINT", "END", "OFFSET", "CHANNELS", "MOTION", "HIERARCHY", "{", "}")


@dataclass
class BvhText:
    """A BVH file as written.

    Attributes:
        full_names: joint names with their namespaces; end sites are called `<parent>_end`.
        parents, offsets, channels: of each joint; channel names in lower case.
        frame_time_s: as the file says, None where it says nothing.
        rows: (T, channels) values.
        warnings: what was passed over.
    """

    full_names: list[str] = field(default_factory=list)
    parents: list[int] = field(default_factory=list)
    offsets: list[list[float]] = field(default_factory=list)
    channels: list[list[str]] = field(default_factory=list)
    frame_time_s: float | None = None
    rows: Array = field(default_factory=lambda: np.zeros((0, 0)))
    warnings: list[str] = field(default_factory=list)

    @property
    def names(self) -> tuple[str, ...]:
        """Joint names without namespaces."""
        return tuple(name.split(":")[-1] for name in self.full_names)


class _Reader:
    def __init__(self, path: Path):
        self._name = path.name
        self._lines = read_lines(path)
        self._unknown: dict[str, int] = {}
        self.out = BvhText()

    def fail(self, index: int, what: str) -> NoReturn:
        raise InvalidInputError(f"{self._name}: line {index + 1}: {what}", field="path")

    def hierarchy(self) -> int:
        """Read the joint tree; returns the index of the line after MOTION."""
        stack: list[int] = []
        pending = -1
        for index, line in enumerate(self._lines):
            if line.lstrip().startswith(("#", "//")):
                continue
            # Braces may stand on the line of the name or of one another.
            words = re.sub(r"([{}])", r" \1 ", line).split()
            while words:
                key = words.pop(0)
                kind = key.upper()
                if kind in ("ROOT", "JOINT", "END", "ENDSITE"):
                    until = words.index("{") if "{" in words else len(words)
                    pending = self._joint(index, kind, " ".join(words[:until]), stack)
                    words = words[until:]
                elif key == "{":
                    if pending < 0:
                        self.fail(index, "'{' without a joint")
                    stack.append(pending)
                    pending = -1
                elif key == "}":
                    if not stack:
                        self.fail(index, "'}' without its '{'")
                    stack.pop()
                elif kind == "OFFSET" and stack:
                    words = self._offset(index, words, stack[-1])
                elif kind == "CHANNELS" and stack:
                    words = self._channels(index, words, stack[-1])
                elif kind == "MOTION":
                    if stack:
                        self.fail(index, f"MOTION before the '}}' of {self.out.full_names[stack[-1]]}")
                    if not self.out.full_names:
                        self.fail(index, "MOTION without a ROOT before it")
                    return index + 1
                elif kind != "HIERARCHY":
                    text = line.strip()[:60]
                    self.fail(index, f"not BVH: {text!r}" if text.isprintable() else "not BVH, but binary data")
        self.fail(len(self._lines) - 1, "the file ends without a MOTION section")

    def _joint(self, index: int, kind: str, name: str, stack: list[int]) -> int:
        out, name = self.out, name.strip("\"'")
        if kind == "JOINT" and not stack:
            self.fail(index, f"JOINT {name} is in no ROOT")
        if kind in ("END", "ENDSITE") and not stack:
            self.fail(index, "an End Site in no joint")
        parent = stack[-1] if stack else -1
        out.full_names.append(f"{out.full_names[parent]}_end" if kind.startswith("END") else name or "unnamed")
        out.parents.append(parent)
        out.offsets.append([0.0, 0.0, 0.0])
        out.channels.append([])
        return len(out.full_names) - 1

    def _offset(self, index: int, words: list[str], joint: int) -> list[str]:
        values = words[:3]
        try:
            self.out.offsets[joint] = [number(w) for w in values]
        except ValueError:
            self.fail(index, f"OFFSET {' '.join(values)[:60]!r} is not three numbers")
        if len(values) != 3 or not all(math.isfinite(v) for v in self.out.offsets[joint]):
            self.fail(index, f"OFFSET {' '.join(values)[:60]!r} is not three numbers")
        return words[3:]

    def _channels(self, index: int, words: list[str], joint: int) -> list[str]:
        if not words or not words[0].isdigit():
            self.fail(index, "CHANNELS without their number")
        count = int(words[0])
        channels = [_spelled(w) for w in words[1 : 1 + count]]
        if len(channels) != count or any(c.upper() in _KEYWORDS for c in channels):
            self.fail(index, f"CHANNELS says {count}, but names {len(words) - 1}")
        if "wrotation" in channels:
            self.fail(index, "rotations as quaternions are not read, only as angles about x, y and z")
        strange = [c for c in channels if not _known(c)]
        if strange:
            told = ", ".join(strange)
            self._unknown[told] = self._unknown.get(told, 0) + 1
        self.out.channels[joint] += channels
        left = words[1 + count :]
        if left and left[0].upper() not in _KEYWORDS:
            self.fail(index, f"CHANNELS says {count}, but names {len(words) - 1}")
        return left

    def motion(self, start: int) -> None:
        """Read the header of the MOTION section and its rows."""
        said: int | None = None
        rows: list[int] = []
        for index in range(start, len(self._lines)):
            line = self._lines[index]
            if not line.strip() or line.lstrip().startswith(("#", "//")):
                continue
            if (header := _FRAME_TIME.match(line)) is not None:
                self.out.frame_time_s = self._header(index, header.group(1), "Frame Time")
            elif (header := _FRAMES.match(line)) is not None:
                value = self._header(index, header.group(1), "Frames")
                if value != int(value) or value < 0:
                    self.fail(index, f"Frames: {value:g} is no number of frames")
                said = int(value)
            else:
                rows.append(index)
        width = sum(len(c) for c in self.out.channels)
        if width == 0:
            self.fail(start - 1, "no joint has channels: nothing moves")
        if not any(_known(c) for channels in self.out.channels for c in channels):
            told = "; ".join(self._unknown)
            self.fail(start - 1, f"no channel is called as in BVH (Xposition, Zrotation and so on), but {told}")
        for told, count in self._unknown.items():
            self.out.warnings.append(f"channels {told} of {count} joint{'s' * (count > 1)} are passed over")
        if not rows:
            raise InvalidInputError(f"{self._name}: no frames after its MOTION line", field="path")
        if len(rows) > MAX_FRAMES:
            raise InvalidInputError(f"{self._name}: {len(rows)} frames", field="path", allowed=f"<= {MAX_FRAMES}")
        values = self._rows(rows, width)
        if said is None:
            self.out.warnings.append(f"the number of frames is not said; {len(values)} rows are read")
        elif said < len(values) and said > 0:
            # The header counts; an exporter that leaves rows behind it does not mean them.
            self.out.warnings.append(f"Frames says {said}, {len(values)} rows follow: the first {said} are read")
            values = values[:said]
        elif said != len(values):
            self.out.warnings.append(f"Frames says {said}, {len(values)} rows follow: those are read")
        self.out.rows = values

    def _header(self, index: int, word: str | None, what: str) -> float:
        try:
            value = number((word or "").split()[0])
        except (ValueError, IndexError):
            self.fail(index, f"{what} {(word or '')[:40]!r} is not a number")
        if not math.isfinite(value):
            self.fail(index, f"{what} is {value}")
        return value

    def _rows(self, rows: list[int], width: int) -> Array:
        """Values (T, width). A frame may be wrapped over several lines, if all frames are in the same way."""
        parsed: list[Array] = []
        for index in rows:
            try:
                parsed.append(np.array(numbers(self._lines[index], width)))
            except ValueError as error:
                self.fail(index, str(error))
        sizes = [len(p) for p in parsed]
        ends = np.cumsum(sizes[:width]).tolist()
        parts = ends.index(width) + 1 if width in ends else 1
        if parts > 1 and sizes == sizes[:parts] * (len(sizes) // parts):
            rows, sizes = rows[::parts], [width] * (len(sizes) // parts)
            parsed = list(np.concatenate(parsed).reshape(-1, width))
        for index, size in zip(rows, sizes, strict=True):
            if size != width:
                last = " (the last row: the file seems to be cut off)" if index == rows[-1] and size < width else ""
                self.fail(index, f"{size} values where the channels make {width}{last}")
        values = np.array(parsed)
        bad = ~np.isfinite(values)
        if bad.any():
            row, column = (int(v) for v in np.argwhere(bad)[0])
            names = [f"{name} {c}" for name, cs in zip(self.out.names, self.out.channels, strict=True) for c in cs]
            self.fail(rows[row], f"value {column + 1} ({names[column]}) is {values[row, column]}")
        return values


_SHORT = re.compile(r"(?P<axis>[xyz])_?(?P<kind>rot|pos|trans)[a-z]*|(?P<first>rot|pos|trans)[a-z]*_?(?P<last>[xyz])")


def _spelled(word: str) -> str:
    """A channel's name in lower case, as BVH has it: `xrotation` for `XROT` and `rotateX`."""
    word = word.lower().strip(",;\"'")
    found = _SHORT.fullmatch(word)
    if found is None:
        return word
    kind = "rotation" if (found["kind"] or found["first"]) == "rot" else "position"
    return f"{found['axis'] or found['last']}{kind}"


def _known(channel: str) -> bool:
    return channel[:1] in ("x", "y", "z") and channel[1:] in ("rotation", "position")


def read_bvh_text(path: Path) -> BvhText:
    """Read the text of a BVH file.

    Raises:
        InvalidInputError: it is none; the message names the line and what is wrong with it.
    """
    reader = _Reader(path)
    reader.motion(reader.hierarchy())
    return reader.out
