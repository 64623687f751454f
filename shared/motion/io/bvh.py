"""BVH: a reader for any hierarchy and a writer for the canonical skeleton."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from shared.errors import InvalidInputError
from shared.motion.clip import MotionClip
from shared.motion.io.assemble import assemble
from shared.motion.io.axes import Y_UP_TO_Z_UP
from shared.motion.io.bvh_text import BvhText, read_bvh_text
from shared.motion.io.fitted import fit_rotations
from shared.motion.io.landmarks import Array, find_landmarks
from shared.motion.io.options import ReadOptions, rate_of
from shared.motion.io.raw import RawMotion, compose, euler_matrix
from shared.motion.rotations import matrix_from_6d


def read_bvh(
    path: str | Path,
    up: str = "auto",
    unit_m: float | None = None,
    fps: float | None = None,
    joints: Mapping[str, str] | None = None,
    root: str | None = None,
) -> RawMotion:
    """Read a BVH file. Of several roots the first that has legs is read, and said so in the warnings.

    Args:
        path: the file.
        up: the file's vertical axis, or "auto": by the zero pose, else by how the body is held.
        unit_m: metres in one unit of the file; None guesses it from the leg length.
        fps: frames per second in place of the file's.
        joints: our joint names to the file's, where its names are not known.
        root: of several roots the one to read.

    Raises:
        InvalidInputError: not a BVH file (the message names the line), a rate that no recording has, or a skeleton
            without recognisable legs.
    """
    path = Path(path)
    options = ReadOptions(fps, up, unit_m, joints, root)
    text = read_bvh_text(path)
    if text.frame_time_s == 0 and fps is None:
        raise InvalidInputError(f"{path.name}: Frame Time is 0 (give the rate with --fps)", field="fps")
    said = 1.0 / text.frame_time_s if text.frame_time_s else None
    wording = f"Frame Time {text.frame_time_s:g} s means" if text.frame_time_s else ""
    rate, warnings = rate_of(path.name, said, options, wording)
    joints_read, chosen = _person(path.name, text, options)
    warnings = text.warnings + warnings + chosen
    try:
        return _motion(text, joints_read, rate, str(path), options, warnings)
    except InvalidInputError as error:
        raise InvalidInputError(f"{path.name}: {error.message}", field=error.field, allowed=error.allowed) from error


def _person(file: str, text: BvhText, options: ReadOptions) -> tuple[list[int], list[str]]:
    """Joints of the root that was asked for, else of the first that has legs, and what to say where there are several.

    Raises:
        InvalidInputError: none of several roots is the one that was asked for.
    """
    tops: list[int] = []
    for joint, parent in enumerate(text.parents):
        tops.append(joint if parent < 0 else tops[parent])
    roots = [joint for joint, parent in enumerate(text.parents) if parent < 0]
    if len(roots) == 1:
        return list(range(len(tops))), []
    names = ", ".join(text.full_names[root] for root in roots)
    if options.root is not None:
        wanted = [root for root in roots if options.root in (text.full_names[root], text.names[root])]
        if not wanted:
            raise InvalidInputError(f"{file}: no root is called {options.root!r}", field="root", allowed=names)
        return [joint for joint, top in enumerate(tops) if top == wanted[0]], []
    people = []
    for root in roots:
        own = [joint for joint, top in enumerate(tops) if top == root]
        index = {joint: i for i, joint in enumerate(own)}
        parents = tuple(index.get(text.parents[joint], -1) for joint in own)
        try:
            find_landmarks(tuple(text.names[joint] for joint in own), parents, options.joints)
        except InvalidInputError:
            continue
        people.append(own)
    if not people:
        return list(range(len(tops))), []
    which = "the one with legs"
    if len(people) > 1:
        which = f"the first of {len(people)} with legs (--root says otherwise)"
    return people[0], [f"{len(roots)} roots ({names}): {text.full_names[people[0][0]]} is read, {which}"]


def _motion(
    text: BvhText, own: list[int], fps: float, source: str, options: ReadOptions, warnings: list[str]
) -> RawMotion:
    """The motion of the joints `own`, whose channels are found in the rows of the whole file."""
    index = {joint: i for i, joint in enumerate(own)}
    parents = tuple(index.get(text.parents[joint], -1) for joint in own)
    starts = np.cumsum([0, *(len(c) for c in text.channels)])
    written = np.array([text.offsets[joint] for joint in own])
    offsets = written.copy()
    frames = len(text.rows)
    local = np.broadcast_to(np.eye(3), (frames, len(own), 3, 3)).copy()
    moving: dict[int, Array] = {}
    turned = False
    for i, joint in enumerate(own):
        channels = text.channels[joint]
        block = text.rows[:, starts[joint] : starts[joint + 1]]
        turns = [k for k, c in enumerate(channels) if c[1:] == "rotation"]
        if turns:
            turned = turned or bool(block[:, turns].any())
            local[:, i] = euler_matrix("".join(channels[k][0] for k in turns), np.radians(block[:, turns]))
        shifts = {"xyz".index(c[0]): block[:, k] for k, c in enumerate(channels) if c[1:] == "position"}
        if shifts:
            moving[i] = _shifted(offsets[i], shifts, frames, parents[i] < 0)
            if parents[i] >= 0 and not np.linalg.norm(offsets[i]) > 1e-9:
                # The bone's length stands in the channels only: their median makes the zero pose.
                offsets[i] = np.median(moving[i], axis=0)
    still = np.broadcast_to(offsets[0], (frames, 3))
    positions, world = compose(parents, offsets, still, local, moving)
    if not turned and sum(bool(np.ptp(place, axis=0).any()) for place in moving.values()) > 1:
        # Without bones in the file its first frame is the zero pose.
        first = positions[0] - positions[0, np.maximum(parents, 0)]
        offsets = np.where(np.linalg.norm(written, axis=1, keepdims=True) > 1e-9, written, first)
        world = fit_rotations(parents, offsets, positions)
        warnings = [*warnings, "no joint turns, they only move: the rotations are fitted to the positions"]
    return assemble(
        tuple(text.names[joint] for joint in own),
        parents,
        offsets,
        positions,
        world,
        fps,
        source,
        options,
        full_names=[text.full_names[joint] for joint in own],
        warnings=warnings,
    )


def _shifted(offset: Array, shifts: dict[int, Array], frames: int, root: bool) -> Array:
    """(T, 3) place of a joint in its parent by its position channels.

    They stand in place of the offset. A few programs add them to it: then they are near zero where the bone is not.
    """
    place = np.broadcast_to(offset, (frames, 3)).copy()
    for axis, values in shifts.items():
        place[:, axis] = values
    if root:
        return place
    given = list(shifts)
    step = place[:, given]
    bone = offset[given]
    if np.median(np.linalg.norm(step, axis=1)) < 0.5 * np.linalg.norm(bone):
        place[:, given] = step + bone
    return place


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
