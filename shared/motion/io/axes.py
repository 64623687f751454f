"""Which way is up in a file, and how long its unit is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from shared.motion.io.landmarks import Array
from shared.motion.rotations import normalize

Y_UP_TO_Z_UP = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""World with Y up and +Z forward -> Z up and +X forward: (x, y, z) becomes (z, x, y)."""

_X_UP_TO_Z_UP = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
TURNS: dict[str, Array] = {
    "z": np.eye(3),
    "y": Y_UP_TO_Z_UP,
    "x": _X_UP_TO_Z_UP,
    "-z": np.diag([1.0, -1.0, -1.0]),
    "-y": Y_UP_TO_Z_UP @ np.diag([1.0, -1.0, -1.0]),
    "-x": _X_UP_TO_Z_UP @ np.diag([-1.0, -1.0, 1.0]),
}
"""Rotation that takes a world with that axis up to Z up."""

UNITS_M = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "0.45in": 0.0254 / 0.45}
"""Length units seen in files, in metres."""

_LEG_LENGTH_M = 0.82
_UPRIGHT = 0.8
_MOSTLY = 0.8
_FLAT = 0.3


@dataclass(frozen=True)
class Up:
    """The vertical of a file: `world` of its motion, `rest` of its zero pose (they differ where the root's rotation
    takes one into the other), and a sentence where the two had to be weighed."""

    world: str
    rest: str
    warning: str = ""


def axis_of(direction: Array, least: float = _UPRIGHT) -> str | None:
    """The axis ('x', '-y', ...) a direction (3,) is along, or None where it is along none."""
    u = normalize(direction)
    i = int(np.abs(u).argmax())
    return None if abs(u[i]) < least else ("" if u[i] > 0 else "-") + "xyz"[i]


def _body_up(positions: Array, marks: Mapping[str, int]) -> tuple[Array, Array | None]:
    """Unit directions (T, 3) along the legs and along the trunk, both toward the head; None without a head or neck."""

    def middle(part: str) -> Array:
        return np.asarray(0.5 * (positions[:, marks[f"left_{part}"]] + positions[:, marks[f"right_{part}"]]))

    legs = normalize(middle("hip") - middle("ankle"))
    top = next((positions[:, marks[m]] for m in ("neck", "head") if m in marks), None)
    if top is None and "left_shoulder" in marks and "right_shoulder" in marks:
        top = middle("shoulder")
    return legs, None if top is None else normalize(top - middle("hip"))


def rest_up(rest: Array, marks: Mapping[str, int]) -> str | None:
    """The vertical of a zero pose (J, 3), or None where it is no standing person: legs and trunk must part ways."""
    legs, trunk = _body_up(rest[None], marks)
    if np.linalg.norm(legs) < 0.5 or (trunk is not None and float(legs[0] @ trunk[0]) < 0.7):
        return None
    return axis_of(legs[0] if trunk is None else legs[0] + trunk[0])


def upright_share(positions: Array, marks: Mapping[str, int]) -> float:
    """Share of the frames of a motion (T, J, 3) with Z up in which the body leans 37 degrees at most."""
    return float(np.mean(_body(positions, marks)[:, 2] > _UPRIGHT))


def _body(positions: Array, marks: Mapping[str, int]) -> Array:
    legs, trunk = _body_up(positions, marks)
    return legs if trunk is None else normalize(legs + trunk)


def posture_up(positions: Array, marks: Mapping[str, int]) -> tuple[str, float]:
    """The axis along which the body is held most, and the share of frames in which it is upright along it."""
    body = _body(positions, marks)
    mean = np.concatenate([np.clip(body, 0.0, None), np.clip(-body, 0.0, None)], axis=1).mean(axis=0)
    # Without a rest pose to go by, the usual axes come first: another must be held much more.
    i = int((mean * np.array([0.6, 1.0, 0.999, 0.6, 0.6, 0.6])).argmax())
    axis = ("" if i < 3 else "-") + "xyz"[i % 3]
    along = body[:, i % 3] * (1 if i < 3 else -1)
    return axis, float(np.mean(along > _UPRIGHT))


def find_up(rest: Array, positions: Array, marks: Mapping[str, int], above: Array | None = None) -> Up:
    """The vertical of a motion: by its zero pose, and where that says nothing by how the body is held.

    Where the zero pose stands along one axis and the person along another throughout, the root's rotation may be
    what takes one world into the other, or the person may lie: the floor decides, which is flat under a walk and at
    zero under many, and the way that is gone.

    Args:
        rest: (J, 3) the zero pose. positions: (T, J, 3) the motion.
        above: (3, 3) rotation that joints above the pelvis hold throughout, if any.
    """
    in_rest = rest_up(rest, marks)
    held, share = posture_up(positions, marks)
    if in_rest is None:
        return Up(held, held)
    through = in_rest if above is None else axis_of(above @ vector(in_rest)) or in_rest
    if held == through or share < _MOSTLY:
        return Up(through, in_rest)
    body = positions[:, [i for i in marks.values()]]
    hip = positions[:, marks["left_hip"]] - positions[:, marks["left_ankle"]]
    leg = float(np.percentile(np.linalg.norm(hip, axis=-1), 90))
    low = {axis: (body @ vector(axis)).min(axis=1) / max(leg, 1e-9) for axis in (held, through)}
    flat = {axis: float(np.ptp(np.percentile(h, [5, 95]))) < _FLAT for axis, h in low.items()}
    # Whoever goes a way at a right angle to the body does not lie; a crawl goes along it.
    goes = float(np.ptp(positions[:, marks["left_hip"]], axis=0)[np.arange(3) != "xyz".index(held[-1])].max())
    stands = not flat[through] or abs(float(np.median(low[held]))) < _FLAT or goes > leg
    if flat[held] and stands:
        return Up(held, in_rest, _weighed(through, held, held))
    return Up(through, in_rest, _weighed(through, held, through))


def vector(axis: str) -> Array:
    """Unit vector (3,) along 'x', '-y', ..."""
    out = np.zeros(3)
    out["xyz".index(axis[-1])] = -1.0 if axis[0] == "-" else 1.0
    return out


def _weighed(rest: str, held: str, chosen: str) -> str:
    return (
        f"the zero pose stands along {rest.upper()}, the body is held along {held.upper()}: "
        f"read with {chosen.upper()} up (--up says otherwise)"
    )


def guess_unit_m(leg_length: float) -> tuple[float, str]:
    """Metres in a file's unit, from the length of thigh and shank in that unit, and a sentence where it is a guess."""
    ratios = {unit: abs(np.log(leg_length * unit / _LEG_LENGTH_M)) for unit in UNITS_M.values()}
    unit = min(ratios, key=lambda u: ratios[u])
    # Off by more than a factor 1.6: an unusual unit; the leg is then taken to be of average length.
    if ratios[unit] < 0.47:
        return unit, ""
    unit = _LEG_LENGTH_M / leg_length
    return unit, f"no usual unit fits legs of {leg_length:.4g}: 1 is taken to be {unit:.4g} m (--unit says otherwise)"


def unit_name(unit_m: float) -> str:
    """'cm', or '0.02 m' for what has no name."""
    return next((name for name, m in UNITS_M.items() if abs(m / unit_m - 1) < 1e-6), f"{unit_m:.4g} m")
