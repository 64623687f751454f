"""What a planned motion would touch first, roughly: bodies as spheres, an object as upright cylinders."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.motion.skeleton import CANONICAL
from shared.scenes.schema import Part, SceneBody
from shared.tasks.object_rules import GRAVITY_MPS2

Array = npt.NDArray[np.float64]

RADII_M = {
    "pelvis": 0.12, "spine1": 0.12, "spine2": 0.13, "spine3": 0.14, "neck": 0.07, "head": 0.1, "collar": 0.08,
    "hip": 0.1, "shoulder": 0.08, "elbow": 0.05, "wrist": 0.07, "knee": 0.06, "ankle": 0.05, "foot": 0.07,
}  # fmt: skip
"""About each joint: half of how thick the body is there, hands and toes with what is beyond the joint."""
FINER = 4
"""A blow is faster than a planner's frames: so many places are looked at for one."""
LEAD_S = 0.3
SPEED_S = 0.04
"""Over so long the speed of a touch is told."""
CLUMSY = -10.0
SLENDER = 4.0 / 3.0
"""Moment of inertia of a slender body about its end, as against all its mass at the centre."""
TO_SPARE = 1.5
"""So many times the energy that it takes, as whoever lets go cannot help any more."""


@dataclass(frozen=True)
class Upright:
    """A solid of revolution that stands: (N, 3) radius, lowest and highest point of its cylinders, about (x, y)."""

    cylinders_m: Array
    xy_w_m: Array

    @classmethod
    def of(cls, body: SceneBody, xy_w_m: Array) -> Upright:
        """A body of a scene that stands at (2,) `xy_w_m`, whatever way it is turned about the vertical."""
        return cls(np.array([_cylinder(part) for part in body.parts]), np.asarray(xy_w_m, dtype=np.float64))

    def gap_m(self, points_w_m: Array, radii_m: Array) -> Array:
        """(..., J) from spheres at (..., J, 3) to the surface, negative within; level with it, else far off."""
        away = np.linalg.norm(points_w_m[..., :2] - self.xy_w_m, axis=-1)[..., None]
        height = points_w_m[..., 2, None]
        radius, low, high = self.cylinders_m.T
        beside = (height > low - radii_m[:, None]) & (height < high + radii_m[:, None])
        return np.asarray(np.where(beside, away - radius - radii_m[:, None], np.inf).min(axis=-1))


@dataclass(frozen=True)
class Tipping:
    """What leans as a pendulum that stands on its lower edge.

    Attributes:
        edge_rad: the lean at which its centre of mass is over the edge. arm_m: from the edge to that centre.
    """

    edge_rad: float
    arm_m: float

    @classmethod
    def of(cls, body: SceneBody) -> Tipping:
        """Of a body of a scene that stands as its file has it; parts without a mass weigh by their volume."""
        solids = np.array([_cylinder(part) for part in body.parts])
        radius, low, high = solids.T
        volumes = radius**2 * (high - low)
        weights = np.array([part.mass_kg or volume for part, volume in zip(body.parts, volumes, strict=True)])
        up = float(np.average((low + high) / 2, weights=weights) - low.min())
        out = float(radius[np.argmin(low)])
        return cls(float(np.arctan2(out, up)), float(np.hypot(out, up)))

    def goes(self, lean_rad: float, rate_radps: float) -> bool:
        """Whether it goes down by itself: it has what it takes to get over its edge, and some more."""
        left = max(self.edge_rad - lean_rad, 0.0)
        wanted = 2.0 * GRAVITY_MPS2 * (1.0 - np.cos(left)) / (SLENDER * self.arm_m)
        return bool(rate_radps > 0 and rate_radps**2 > TO_SPARE * wanted)


def worth_of_blow(
    positions_w_m: Array, fps: float, scale: float, solid: Upright, limb: Sequence[str], speed_worth: float
) -> float:
    """How good a planned blow is: the more the longer the limb is there before anything else, and maybe the faster.

    Args:
        positions_w_m: (T, 22, 3) at `fps`. scale: size of the body against the canonical one.
        limb: joints of the bodies that may touch; the last one is what strikes.
        speed_worth: of a metre a second of what strikes.

    Returns:
        Above 1 where the limb touches first, `CLUMSY` where something else does, between where nothing does: minus the
        way that the limb is short by.
    """
    frames = np.asarray(positions_w_m, dtype=np.float64)
    at = np.arange((len(frames) - 1) * FINER + 1) / FINER
    first = np.minimum(at.astype(int), len(frames) - 2)
    part = (at - first)[:, None, None]
    poses = frames[first] * (1 - part) + frames[first + 1] * part
    gap = solid.gap_m(poses, _radii_m(scale))
    own = np.isin(np.array(CANONICAL.names), list(limb))
    by_limb, by_other = (np.flatnonzero((gap[:, mask] < 0).any(axis=1)) for mask in (own, ~own))
    if len(by_other) and (not len(by_limb) or by_other[0] <= by_limb[0]):
        return CLUMSY
    if not len(by_limb):
        return -float(gap[:, own].min())
    rate = fps * FINER
    lead_s = (by_other[0] - by_limb[0]) / rate if len(by_other) else LEAD_S
    end, back = poses[:, CANONICAL.index(limb[-1])], max(round(SPEED_S * rate), 1)
    way = np.linalg.norm(end[by_limb[0]] - end[max(by_limb[0] - back, 0)])
    return 1.0 + min(lead_s, LEAD_S) / LEAD_S + speed_worth * float(way) * rate / back


def is_in(positions_w_m: Array, scale: float, solid: Upright, joints: Sequence[str]) -> bool:
    """Whether one of some joints' bodies was ever within a solid, in motion (T, 22, 3) of a body of some scale."""
    which = list(CANONICAL.indices(*joints))
    return bool((solid.gap_m(positions_w_m, _radii_m(scale))[:, which] < 0).any())


def _radii_m(scale: float) -> Array:
    """(22,) of a body of some scale."""
    return np.asarray(scale * np.array([RADII_M[name.split("_")[-1]] for name in CANONICAL.names]))


def _cylinder(part: Part) -> tuple[float, float, float]:
    """Radius, lowest and highest point of a primitive that stands upright in its body."""
    x, y, z = part.position_b_m
    size = part.size_m
    if part.shape == "box":
        radius, half = float(np.hypot(size[0], size[1])), size[2]
    elif part.shape == "sphere":
        radius, half = size[0], size[0]
    else:
        radius, half = size[0], size[1] + (size[0] if part.shape == "capsule" else 0.0)
    return radius + float(np.hypot(x, y)), z - half, z + half
