"""BVH: a reader for any hierarchy and a writer for the canonical skeleton."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from shared.errors import InvalidInputError
from shared.motion.clip import MotionClip
from shared.motion.io.landmarks import find_landmarks, leg_length
from shared.motion.io.raw import (
    Y_UP_TO_Z_UP,
    Array,
    RawMotion,
    accumulate,
    compose,
    euler_matrix,
    guess_unit_m,
    guess_up_axis,
    to_z_up,
)
from shared.motion.rotations import matrix_from_6d

MAX_FRAMES = 1_000_000


@dataclass
class _Hierarchy:
    names: list[str] = field(default_factory=list)
    parents: list[int] = field(default_factory=list)
    offsets: list[list[float]] = field(default_factory=list)
    channels: list[list[str]] = field(default_factory=list)


def _parse_hierarchy(lines: list[str], source: str) -> tuple[_Hierarchy, int]:
    """The joint tree and the index of the MOTION line."""
    h = _Hierarchy()
    stack: list[int] = []
    pending = -1
    for number, line in enumerate(lines):
        words = line.split()
        if not words:
            continue
        key = words[0].upper()
        if key in ("ROOT", "JOINT", "END"):
            parent = stack[-1] if stack else -1
            name = " ".join(words[1:]) if key != "END" else f"{h.names[parent]}_end"
            h.names.append(name.split(":")[-1])
            h.parents.append(parent)
            h.offsets.append([0.0, 0.0, 0.0])
            h.channels.append([])
            pending = len(h.names) - 1
        elif key == "{":
            stack.append(pending)
        elif key == "}":
            stack.pop()
        elif key == "OFFSET":
            h.offsets[stack[-1]] = [float(w) for w in words[1:4]]
        elif key == "CHANNELS":
            h.channels[stack[-1]] = [w.lower() for w in words[2 : 2 + int(words[1])]]
        elif key == "MOTION":
            return h, number
        elif key != "HIERARCHY":
            raise InvalidInputError(f"{source}: line {number + 1} is not BVH: {line[:60]!r}", field="path")
    raise InvalidInputError(f"{source}: no MOTION section", field="path")


def read_bvh(path: str | Path, up: str = "auto", unit_m: float | None = None) -> RawMotion:
    """Read a BVH file.

    Args:
        path: the file.
        up: the file's vertical axis, "y", "z" or "auto" (where the hips are above the feet on average).
        unit_m: metres in one unit of the file; None guesses it from the leg length.

    Raises:
        InvalidInputError: not a BVH file, or a skeleton without recognisable legs.
    """
    path = Path(path)
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    try:
        h, start = _parse_hierarchy(lines, path.name)
        frames = int(lines[start + 1].split(":")[1])
        frame_time = float(lines[start + 2].split(":")[1])
        width = sum(len(c) for c in h.channels)
        if not (0 < frames <= MAX_FRAMES and frame_time > 0):
            raise InvalidInputError(f"{path.name}: {frames} frames of {frame_time} s", field="path")
        values = np.array(" ".join(lines[start + 3 :]).split(), dtype=np.float64)
    except (IndexError, ValueError) as error:
        raise InvalidInputError(f"{path.name}: not a readable BVH file ({error})", field="path") from error
    if values.size < frames * width:
        # A few exporters count one frame too many; whole missing frames are dropped.
        frames = values.size // width
    if frames == 0:
        raise InvalidInputError(f"{path.name}: no frames", field="path")
    values = values[: frames * width].reshape(frames, width)

    joints = len(h.names)
    parents = tuple(h.parents)
    offsets = np.array(h.offsets)
    local = np.broadcast_to(np.eye(3), (frames, joints, 3, 3)).copy()
    root = np.broadcast_to(offsets[0], (frames, 3)).copy()
    column = 0
    for joint, channels in enumerate(h.channels):
        block = values[:, column : column + len(channels)]
        column += len(channels)
        rotation = [i for i, c in enumerate(channels) if c.endswith("rotation")]
        if rotation:
            local[:, joint] = euler_matrix("".join(channels[i][0] for i in rotation), np.radians(block[:, rotation]))
        if parents[joint] < 0:
            for i, channel in enumerate(channels):
                if channel.endswith("position"):
                    root[:, "xyz".index(channel[0])] = block[:, i]
    positions, world = compose(parents, offsets, root, local)
    return assemble(tuple(h.names), parents, offsets, positions, world, 1.0 / frame_time, str(path), up, unit_m)


def assemble(
    names: tuple[str, ...],
    parents: tuple[int, ...],
    offsets: Array,
    positions: Array,
    world: Array | None,
    fps: float,
    source: str,
    up: str,
    unit_m: float | None,
) -> RawMotion:
    """RawMotion from a file's own axes and units; guesses what the caller leaves open."""
    marks = find_landmarks(names, parents)
    if up not in ("auto", "y", "z"):
        raise InvalidInputError(f"unknown up axis {up!r}", field="up", allowed="auto, y, z")
    if up == "auto":
        low = np.array([marks["left_ankle"], marks["right_ankle"]])
        high = np.array([marks["left_hip"], marks["right_hip"]])
        up = guess_up_axis(positions, low, high)
    unit = unit_m if unit_m is not None else guess_unit_m(leg_length(positions, marks))
    if up == "y":
        positions, world, offsets = to_z_up(positions, world, offsets)
    # A frame rate within 0.2 % of a whole number is that number: files round the frame time.
    fps = float(round(fps)) if abs(fps - round(fps)) / fps < 2e-3 else fps
    return RawMotion(
        names, parents, offsets * unit, positions * unit, world, accumulate(parents, offsets * unit), fps, source
    )


def write_bvh(path: str | Path, clip: MotionClip, unit_m: float = 0.01) -> None:
    """Write a clip as BVH: Y up, facing +Z, lengths in centimetres unless `unit_m` says otherwise.

    The hierarchy is the clip's skeleton with its T-pose offsets, so a file opens upright in Blender's importer
    with its default axes (+Z forward, Y up). Leaf joints get an end site of 5 cm.
    """
    skeleton = clip.skeleton
    c = Y_UP_TO_Z_UP
    offsets = skeleton.offsets_m @ c / unit_m
    lines = ["HIERARCHY"]
    order: list[int] = []

    def emit(joint: int, depth: int) -> None:
        pad = "  " * depth
        order.append(joint)
        lines.append(f"{pad}{'ROOT' if joint == 0 else 'JOINT'} {skeleton.names[joint]}")
        lines.append(pad + "{")
        lines.append(f"{pad}  OFFSET " + " ".join(f"{v:.6f}" for v in offsets[joint]))
        position = "6 Xposition Yposition Zposition" if joint == 0 else "3"
        lines.append(f"{pad}  CHANNELS {position} Zrotation Xrotation Yrotation")
        children = skeleton.children(joint)
        for child in children:
            emit(child, depth + 1)
        if not children:
            tip = offsets[joint] / max(float(np.linalg.norm(offsets[joint])), 1e-9) * 0.05 / unit_m
            lines.extend([f"{pad}  End Site", pad + "  {", f"{pad}    OFFSET " + " ".join(f"{v:.6f}" for v in tip)])
            lines.append(pad + "  }")
        lines.append(pad + "}")

    emit(0, 0)
    local = c.T @ matrix_from_6d(clip.rotations_6d) @ c
    angles = np.degrees(_zxy_angles(local))[:, order].reshape(len(clip), -1)
    rows = np.concatenate([clip.root_pos_w_m @ c / unit_m, angles], axis=1)
    lines += ["MOTION", f"Frames: {len(clip)}", f"Frame Time: {1.0 / clip.fps:.8f}"]
    lines += [" ".join(f"{v:.6f}" for v in row) for row in rows]
    Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8")


def _zxy_angles(m: Array) -> Array:
    """Angles (..., 3) with R = Rz(a0) Rx(a1) Ry(a2), the first and last set to one choice at the singularity."""
    x = np.arcsin(np.clip(m[..., 2, 1], -1.0, 1.0))
    singular = np.abs(m[..., 2, 1]) > 1 - 1e-9
    z = np.where(singular, np.arctan2(m[..., 1, 0], m[..., 0, 0]), np.arctan2(-m[..., 0, 1], m[..., 1, 1]))
    y = np.where(singular, 0.0, np.arctan2(-m[..., 2, 0], m[..., 2, 2]))
    return np.stack([z, x, y], axis=-1)
