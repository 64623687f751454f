"""ASF + AMC: Acclaim skeletons (CMU, HDM05) and their motion."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from shared.errors import InvalidInputError
from shared.motion.io.assemble import assemble
from shared.motion.io.landmarks import Array
from shared.motion.io.options import ReadOptions, rate_of
from shared.motion.io.raw import RawMotion, compose, euler_matrix
from shared.motion.io.text import number, read_lines

_INCH_M = 0.0254


@dataclass
class _Bone:
    direction: Array
    length: float
    axis: Array
    dof: list[str]


@dataclass
class _Skeleton:
    """`unit_m`: metres per unit, None where the file does not say; `radians`: what its angles are in."""

    bones: dict[str, _Bone] = field(default_factory=dict)
    links: list[tuple[str, str]] = field(default_factory=list)
    unit_m: float | None = None
    radians: bool = False
    root_order: list[str] = field(default_factory=lambda: ["tx", "ty", "tz", "rx", "ry", "rz"])
    root_axis: Array = field(default_factory=lambda: np.eye(3))


@dataclass
class _Motion:
    """Values per bone, (T, channels); `radians` and `fps` None where the file does not say; `unknown`: names in it that
    its skeleton does not have."""

    values: dict[str, Array]
    radians: bool | None
    fps: float | None
    unknown: list[str]


def _axis_matrix(angles: Array, order: str, radians: bool) -> Array:
    """Rotation of an ASF axis statement: 'XYZ' turns about X first, so the product runs the other way round."""
    order = order.lower()
    angles = np.asarray(angles)[..., ::-1]
    return euler_matrix(order[::-1], angles if radians else np.radians(angles))


def _triple(words: list[str]) -> Array:
    out = np.array([number(word) for word in words])
    if len(out) != 3 or not np.isfinite(out).all():
        raise ValueError("three numbers are needed")
    return out


def _channels(words: list[str]) -> list[str]:
    """Names such as tx, rz and l (a bone's length) in lower case; ValueError for others."""
    out = [word.lower() for word in words]
    strange = [word for word in out if word not in ("tx", "ty", "tz", "rx", "ry", "rz", "l")]
    if strange:
        raise ValueError(f"no channel is called {strange[0]!r}")
    return out


def _read_asf(path: Path) -> _Skeleton:
    """An ASF file. Its angles are in degrees unless `:units` says `angle rad`."""
    out = _Skeleton()
    section = ""
    name, bone = "", _Bone(np.zeros(3), 0.0, np.eye(3), [])
    axis_order, orientation = "XYZ", np.zeros(3)
    for index, line in enumerate(read_lines(path)):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        if words[0].startswith(":"):
            section = words[0][1:].lower()
            continue
        key = words[0].lower()
        try:
            if section == "units" and key == "length":
                out.unit_m = _INCH_M / number(words[1])
            elif section == "units" and key == "angle":
                out.radians = words[1].lower().startswith("rad")
            elif section == "root":
                if key == "order":
                    out.root_order = _channels(words[1:])
                elif key == "axis":
                    axis_order = words[1]
                elif key == "orientation":
                    orientation = _triple(words[1:4])
                out.root_axis = _axis_matrix(orientation, axis_order, out.radians)
            elif section == "bonedata":
                if key == "begin":
                    bone = _Bone(np.zeros(3), 0.0, np.eye(3), [])
                elif key == "name":
                    name = words[1]
                elif key == "direction":
                    bone.direction = _triple(words[1:4])
                elif key == "length":
                    bone.length = number(words[1])
                    if not math.isfinite(bone.length):
                        raise ValueError("a length is finite")
                elif key == "axis":
                    bone.axis = _axis_matrix(_triple(words[1:4]), words[4], out.radians)
                elif key == "dof":
                    bone.dof = _channels(words[1:])
                elif key == "end":
                    out.bones[name] = bone
            elif section == "hierarchy" and key not in ("begin", "end"):
                out.links.extend((child, words[0]) for child in words[1:])
        except (ValueError, IndexError, KeyError, ZeroDivisionError) as error:
            raise InvalidInputError(
                f"{path.name}: line {index + 1}: {line.strip()[:60]!r} cannot be read ({error})", field="asf"
            ) from error
    if not out.bones or not out.links:
        raise InvalidInputError(f"{path.name}: not an ASF skeleton (no bones or no hierarchy)", field="asf")
    return out


def _read_amc(path: Path, widths: Mapping[str, int]) -> _Motion:
    """An AMC file. `widths`: how many values each bone has; what is not among them is passed over."""
    values: dict[str, list[list[float]]] = {}
    seen: set[str] = set()
    unknown: list[str] = []
    frames = 0
    started = 0
    radians: bool | None = None
    fps: float | None = None

    def fail(index: int, what: str) -> InvalidInputError:
        return InvalidInputError(f"{path.name}: line {index + 1}: {what}", field="amc")

    for index, line in enumerate(read_lines(path)):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        if words[0].startswith(":"):
            key = words[0][1:].lower()
            if key in ("radians", "degrees"):
                radians = key == "radians"
            elif key in ("samples-per-second", "samplespersecond", "fps", "frame-rate", "framerate") and words[1:]:
                try:
                    fps = number(words[1])
                except ValueError:
                    raise fail(index, f"the rate {words[1]!r} is not a number") from None
            continue
        if len(words) == 1 and words[0].isdigit():
            if frames and seen != set(values):
                raise fail(started, f"frame {frames} has no {', '.join(sorted(set(values) - seen))}")
            frames, started, seen = frames + 1, index, set()
            continue
        if not frames:
            raise fail(index, f"{words[0]!r} before the first frame number")
        if words[0] not in widths:
            if words[0] not in unknown:
                unknown.append(words[0])
            continue
        try:
            row = [number(w) for w in words[1:]]
        except ValueError:
            raise fail(index, f"{line.strip()[:60]!r} has a value that is not a number") from None
        if len(row) != widths[words[0]]:
            raise fail(index, f"{words[0]} has {len(row)} values where its skeleton has {widths[words[0]]}")
        if not all(math.isfinite(v) for v in row):
            raise fail(index, f"a value of {words[0]} is not finite")
        if words[0] in seen or (frames > 1 and words[0] not in values):
            raise fail(index, f"{words[0]} does not occur once in every frame")
        seen.add(words[0])
        values.setdefault(words[0], []).append(row)
    if not frames or "root" not in values:
        raise InvalidInputError(f"{path.name}: no frames with a root in it", field="amc")
    if seen != set(values):
        raise fail(
            started, f"the last frame has no {', '.join(sorted(set(values) - seen))}: the file seems to be cut off"
        )
    return _Motion({name: np.array(rows) for name, rows in values.items()}, radians, fps, unknown)


def _ordered(links: list[tuple[str, str]], path: Path, bones: Mapping[str, _Bone]) -> dict[str, str]:
    """Parent of each bone, parents before their children, otherwise in the order of the file."""
    out: dict[str, str] = {}
    left = list(links)
    while left:
        later = []
        for child, parent in left:
            if parent != "root" and parent not in out:
                later.append((child, parent))
            elif child in out or child not in bones:
                raise InvalidInputError(f"{path.name}: {child} of the hierarchy is not defined once", field="asf")
            else:
                out[child] = parent
        if len(later) == len(left):
            raise InvalidInputError(f"{path.name}: {left[0][1]} of the hierarchy hangs on no root", field="asf")
        left = later
    return out


def _listed(names: list[str]) -> str:
    """The first few names."""
    return ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")


def read_asf_amc(
    asf: str | Path,
    amc: str | Path,
    fps: float | None = None,
    unit_m: float | None = None,
    up: str = "auto",
    joints: Mapping[str, str] | None = None,
) -> RawMotion:
    """Read an ASF skeleton and one AMC motion of it. Joint `x` is the far end of the bone `x`; `root` the root.

    Args:
        asf: skeleton file.
        amc: motion file; few carry a rate.
        fps: its frames per second; None takes the file's, or assumes 30 and says so.
        unit_m: metres per unit; None takes 0.0254 m over the ASF's `length` unit (CMU, HDM05: 0.45 inch).
        up: vertical axis, or "auto".
        joints: our joint names to the skeleton's (the far ends of its bones).

    Raises:
        InvalidInputError: a malformed file (the message names the line), or a skeleton without recognisable legs.
    """
    asf, amc = Path(asf), Path(amc)
    options = ReadOptions(fps, up, unit_m, joints)
    skeleton = _read_asf(asf)
    bones = skeleton.bones
    parent_of = _ordered(skeleton.links, asf, bones)
    widths = {name: len(bone.dof) for name, bone in bones.items()} | {"root": len(skeleton.root_order)}
    motion = _read_amc(amc, widths)
    rate, warnings = rate_of(amc.name, motion.fps, options)
    if motion.unknown:
        warnings.append(f"{asf.name} has no {_listed(motion.unknown)}: passed over")
    if still := [name for name, bone in bones.items() if bone.dof and name not in motion.values]:
        warnings.append(f"no values for {_listed(still)} of {asf.name}: held as in its zero pose")
    names = ("root", *parent_of)
    index = {name: i for i, name in enumerate(names)}
    parents = (-1, *(index[parent] for parent in parent_of.values()))
    frames = len(motion.values["root"])
    in_radians = skeleton.radians if motion.radians is None else motion.radians

    def radians(angles: Array) -> Array:
        return angles if in_radians else np.asarray(np.radians(angles))

    # The far end of bone x moves with x's own rotation, while in a joint tree it would move with its parent's:
    # so the rotation of x is applied first and its end is placed with it.
    root = motion.values["root"]
    place = {c: root[:, i] for i, c in enumerate(skeleton.root_order)}
    position = np.stack([place.get(c, np.zeros(frames)) for c in ("tx", "ty", "tz")], axis=-1)
    turn = [c for c in skeleton.root_order if c[0] == "r"]
    rotation = euler_matrix("".join(c[1] for c in turn)[::-1], radians(np.stack([place[c] for c in turn[::-1]], -1)))
    local = np.broadcast_to(np.eye(3), (frames, len(names), 3, 3)).copy()
    local[:, 0] = skeleton.root_axis @ rotation @ skeleton.root_axis.T
    offsets = np.zeros((len(names), 3))
    for name, i in index.items():
        if name == "root":
            continue
        bone = bones[name]
        offsets[i] = bone.direction * bone.length
        dof = [d for d in bone.dof if d[0] == "r"]
        if name in motion.values and dof:
            columns = [bone.dof.index(d) for d in dof]
            angles = radians(motion.values[name][:, columns])
            m = euler_matrix("".join(d[1] for d in dof)[::-1], angles[:, ::-1])
            local[:, i] = bone.axis @ m @ bone.axis.T
    _, world = compose(parents, offsets, position, local)
    positions = np.empty((frames, len(names), 3))
    positions[:, 0] = position
    for i in range(1, len(names)):
        positions[:, i] = positions[:, parents[i]] + world[:, i] @ offsets[i]
    try:
        return assemble(
            names, parents, offsets, positions, world, rate, str(amc), options,
            unit_m=skeleton.unit_m, ends=True, warnings=warnings,
        )  # fmt: skip
    except InvalidInputError as error:
        raise InvalidInputError(f"{amc.name}: {error.message}", field=error.field, allowed=error.allowed) from error
