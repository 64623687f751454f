"""From a file's joints, axes and units to a RawMotion in metres with Z up."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from shared.errors import InvalidInputError
from shared.motion.io.axes import TURNS, Up, find_up, guess_unit_m, rest_up
from shared.motion.io.landmarks import Array, find_landmarks, find_segments, leg_length
from shared.motion.io.names import family
from shared.motion.io.options import ReadOptions
from shared.motion.io.raw import RawMotion, accumulate

_LEGS_M = (0.25, 1.6)


def assemble(
    names: tuple[str, ...],
    parents: tuple[int, ...],
    offsets: Array,
    positions: Array,
    world: Array,
    fps: float,
    source: str,
    options: ReadOptions,
    *,
    full_names: Sequence[str] = (),
    unit_m: float | None = None,
    ends: bool = False,
    warnings: Sequence[str] = (),
) -> RawMotion:
    """RawMotion from a file's own axes and units; what the options leave open is found from the skeleton.

    Args:
        offsets: (J, 3) of the zero pose; positions: (T, J, 3); world: (T, J, 3, 3).
        full_names: the names with their namespaces, which tell the family.
        unit_m: metres per unit as the file says.
        ends: a joint is the far end of the bone it is called after (Acclaim).

    Raises:
        InvalidInputError: no legs are found, or they have no length.
    """
    said = list(warnings)
    marks = find_landmarks(names, parents, options.joints, ends)
    segments = find_segments(names, parents, marks, ends)
    leg = leg_length(positions, marks)
    if not leg > 1e-6:
        raise InvalidInputError("the bones of the legs have no length", field="skeleton")
    rest = accumulate(parents, offsets)
    if options.up == "auto":
        up = find_up(rest, positions, marks, _held_above(parents, segments["pelvis"], world))
    else:
        up = Up(options.up, rest_up(rest, marks) or options.up)
    if up.warning:
        said.append(up.warning)
    unit = options.unit_m if options.unit_m is not None else unit_m
    if unit is not None and options.unit_m is None and not _LEGS_M[0] < leg * unit < _LEGS_M[1]:
        said.append(f"by the file's own unit the legs would be {leg * unit:.3g} m long; the unit is taken from them")
        unit = None
    if unit is None:
        unit, doubt = guess_unit_m(leg)
        said += [doubt] if doubt else []
    elif not _LEGS_M[0] < leg * unit < _LEGS_M[1]:
        said.append(f"legs of {leg * unit:.3g} m in the unit that was asked for")
    if not any(mark in marks for mark in ("left_shoulder", "right_shoulder", "left_elbow", "right_elbow")):
        said.append("no arms were found: they hang")
    # The zero pose and the motion are turned to Z up each by its own axis: rotations lead from one to the other.
    c_world, c_rest = TURNS[up.world], TURNS[up.rest]
    offsets = offsets @ c_rest.T * unit
    return RawMotion(
        names,
        parents,
        offsets,
        positions @ c_world.T * unit,
        c_world @ world @ c_rest.T,
        accumulate(parents, offsets),
        fps,
        source,
        up.world,
        unit,
        "map" if options.joints else family(full_names or names),
        tuple(said),
        marks,
        segments,
    )


def _held_above(parents: tuple[int, ...], pelvis: int, world: Array) -> Array | None:
    """Rotation (3, 3) of the joint above the pelvis where it stays the same throughout, such as an armature's."""
    above = parents[pelvis]
    if above < 0 or float(np.abs(world[:, above] - world[:1, above]).max()) > 1e-3:
        return None
    return np.asarray(world[0, above])
