"""Success rules of the tasks with objects, `strict`, `paper` and `code` side by side (DESIGN 7, REFERENCE 3).

Pure numpy over recorded traces at 30 Hz. `paper` and `code` know no contacts: they only ask where things are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.protocol.messages import TICK_HZ
from shared.tasks.interface import Trace
from shared.tasks.object_specs import Limb
from shared.tasks.places import MarkedObject
from shared.tasks.rules import HOLD_TICKS, SAFE_TICKS, lying
from shared.tasks.world import THE_FLOOR, World

Array = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

TOPPLED_RAD = np.deg2rad(75.5)
PAPER_TILT_RAD = np.deg2rad(15.0)
"""The paper counts a bag whose angle with the ground is below 75 deg."""
PELVIS_ABOVE_M = 0.18
SEAT_SHARE = 0.5
GRAVITY_MPS2 = 9.81
CODE_AREA_M = (0.6, 1.25)
CODE_ABOVE_M = (0.3 - 0.344, 0.5 - 0.344)
"""The release asks for a pelvis 0.3 to 0.5 m high over its sofa of 0.344 m; here that goes with the seat's top."""
STOOD_M = 0.3
SMOOTH_TICKS = 3
"""Impulses are told over so many ticks: contacts of a solver come and go from one to the next."""

LIMBS: dict[Limb, tuple[str, ...]] = {
    "left_hand": ("left_elbow", "left_wrist"),
    "right_hand": ("right_elbow", "right_wrist"),
    "left_foot": ("left_knee", "left_ankle", "left_foot"),
    "right_foot": ("right_knee", "right_ankle", "right_foot"),
}
"""Bodies of the lower segment of each limb: a body bears the name of the joint it hangs on, so that the forearm is
`left_elbow` and the shin `left_knee`."""


@dataclass(frozen=True)
class Outcome:
    """`met_tick`: index at which what the strict rule asks for began, or None; a fall may still spoil it."""

    strict: bool
    paper: bool
    code: bool
    met_tick: int | None


NOTHING = Outcome(False, False, False, None)


@dataclass(frozen=True)
class Blow:
    """What became of a blow.

    Attributes:
        first_tick: index of the first touch by any part of the body, or None. limb_first: it was the limb's.
        most_tilt_rad: largest angle of the object's axis from the vertical.
    """

    outcome: Outcome
    first_tick: int | None
    limb_first: bool
    most_tilt_rad: float


def tilt_rad(pose_w: npt.ArrayLike) -> Array:
    """(T,) angle between the Z axis of an object with poses (T, 7) and the vertical."""
    q = np.asarray(pose_w, dtype=np.float64)[..., 3:]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.asarray(np.arccos(np.clip(1 - 2 * (q[..., 1] ** 2 + q[..., 2] ** 2), -1.0, 1.0)))


def first_stretch(good: Bools, ticks: int = HOLD_TICKS) -> int | None:
    """First index from which `good` holds for `ticks` ticks (that is, at ticks + 1 of them), or None."""
    rows = np.arange(len(good))
    since = rows - np.maximum.accumulate(np.where(good, -1, rows)) if len(good) else rows
    held = np.flatnonzero(since >= ticks + 1)
    return int(held[0]) - ticks if len(held) else None


def strike(world: World, fallen: Bools, name: str, limb: Limb) -> Blow:
    """Strike: object `name` with a limb.

    code: tilted by 75.5 deg at some tick. paper: by 15 deg, and no fall before. strict: the limb is among what touches
    it first, it ends tilted by 75.5 deg, and no fall until a second after it was.
    """
    tilt = tilt_rad(world.pose_w[:, world.objects.index(name)])
    touched = world.impulse_ns(name) > 0
    by_limb = world.impulse_ns(name, LIMBS[limb]) > 0
    first = int(np.argmax(touched)) if touched.any() else None
    limb_first = first is not None and bool(by_limb[first])
    down = tilt >= TOPPLED_RAD
    met = int(np.argmax(down)) if down.any() else None
    leant = tilt > PAPER_TILT_RAD
    paper = bool(leant.any()) and not bool(fallen[: int(np.argmax(leant)) + 1].any())
    fair = met is not None and first is not None and limb_first and first <= met
    strict = fair and met is not None and bool(down[-1]) and not bool(fallen[: met + SAFE_TICKS + 1].any())
    return Blow(Outcome(strict, paper, met is not None, met if fair else None), first, limb_first, float(tilt.max()))


def smoothed(values: Array) -> Array:
    """(T,) mean over up to `SMOOTH_TICKS` ticks, the last of which is each row's own."""
    sums = np.cumsum(np.concatenate([np.zeros(SMOOTH_TICKS), values]))
    counts = np.minimum(np.arange(len(values)) + 1, SMOOTH_TICKS)
    return np.asarray((sums[SMOOTH_TICKS:] - sums[:-SMOOTH_TICKS]) / counts)


def seat_share(world: World, name: str, mass_kg: float) -> Array:
    """(T,) share of the body's weight that an object carries."""
    return smoothed(world.impulse_ns(name)) * TICK_HZ / (mass_kg * GRAVITY_MPS2)


def sit(trace: Trace, seat: MarkedObject, mass_kg: float) -> Outcome:
    """Sit: on the area of a mark on top of a seat.

    code: the pelvis was over a rectangle of 1.2 x 2.5 m, 0.04 below to 0.16 m above the seat's top. paper: over the
    seat at such a height, and no fall before. strict: over the seat, at most 0.18 m above its top, and the seat carries
    half of the weight, all for half a second, and no fall until a second after.
    """
    if trace.world is None or not len(trace):
        return NOTHING
    at = seat.local_m(trace.world, trace.pos_w_m[:, 0])
    along, across, above = np.abs(at[:, 0]), np.abs(at[:, 1]), at[:, 2]
    over = (along <= seat.half_size_m[0]) & (across <= seat.half_size_m[1])
    low = (above >= CODE_ABOVE_M[0]) & (above <= CODE_ABOVE_M[1])
    code = (along <= CODE_AREA_M[0]) & (across <= CODE_AREA_M[1]) & low
    bears = seat_share(trace.world, seat.object, mass_kg) >= SEAT_SHARE if trace.world.felt else True
    met = first_stretch(over & (above >= 0) & (above <= PELVIS_ABOVE_M) & bears)
    on_it = over & low
    paper = bool(on_it.any()) and not bool(trace.fallen[: int(np.argmax(on_it)) + 1].any())
    strict = met is not None and not bool(trace.fallen[: met + HOLD_TICKS + SAFE_TICKS + 1].any())
    return Outcome(strict, paper, bool(code.any()), met)


def on_both_feet(world: World) -> Bools:
    """(T,) whether both feet bear on the floor; yes where that cannot be told."""
    if not world.felt:
        return np.ones(len(world.pose_w), dtype=bool)
    sides = [smoothed(world.impulse_ns(THE_FLOOR, (f"{side}_ankle", f"{side}_foot"))) > 0 for side in ("left", "right")]
    return np.asarray(sides[0] & sides[1])


def get_up(trace: Trace, target_w_m: Array, from_floor: bool) -> Outcome:
    """Get up: the pelvis to (3,) `target_w_m`.

    code: within 0.3 m of it at some tick. paper: and no fall before. strict: within it with both feet on the floor for
    half a second, and no fall until a second after. Who begins on the floor has fallen only after that.
    """
    if not len(trace):
        return NOTHING
    near = np.linalg.norm(trace.pos_w_m[:, 0] - target_w_m, axis=-1) <= STOOD_M
    feet = np.zeros(len(trace), dtype=bool) if trace.world is None else on_both_feet(trace.world)
    met = first_stretch(near & feet)
    begin = (met or 0) if from_floor else 0
    down = lying(trace.pos_w_m) if from_floor else trace.fallen
    strict = met is not None and not bool(down[begin : met + HOLD_TICKS + SAFE_TICKS + 1].any())
    code = bool(near.any())
    before = trace.fallen[: int(np.argmax(near)) + 1]
    return Outcome(strict, code and (from_floor or not bool(before.any())), code, met)
