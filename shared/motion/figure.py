"""How our mannequin looks, as data: the parts of each joint's body, for the renderer and for glTF.

Lengths come from the skeleton, girths from its stature and build. Each part is in the frame of its joint, which in
the T-pose is aligned with the world: X forward, Y left, Z up.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from shared.motion.mesh import Mesh, box, capsule, cylinder, ellipsoid, limb
from shared.motion.skeleton import Skeleton

Vec = tuple[float, ...]
Colour = Literal["body", "left", "right", "joint"]
COLOURS: dict[str, Vec] = {
    "body": (0.86, 0.80, 0.71, 1.0),
    "left": (0.32, 0.55, 0.70, 1.0),
    "right": (0.80, 0.47, 0.34, 1.0),
    "joint": (0.25, 0.26, 0.30, 1.0),
}
"""sRGB with alpha: left blue, right terracotta."""

_OUTLINES: dict[str, tuple[tuple[float, float], ...]] = {
    "hip": ((0.0, 0.043), (0.12, 0.047), (0.35, 0.044), (0.7, 0.034), (0.9, 0.029), (1.0, 0.028)),
    "knee": ((0.0, 0.028), (0.12, 0.029), (0.3, 0.034), (0.5, 0.030), (0.8, 0.020), (1.0, 0.019)),
    "shoulder": ((0.0, 0.028), (0.15, 0.029), (0.45, 0.026), (0.8, 0.021), (1.0, 0.020)),
    "elbow": ((0.0, 0.020), (0.2, 0.023), (0.5, 0.020), (0.85, 0.014), (1.0, 0.013)),
    "collar": ((0.0, 0.034), (0.5, 0.034), (1.0, 0.030)),
    "neck": ((0.0, 0.032), (0.5, 0.029), (1.15, 0.029)),
}
"""Outlines of limb segments: (place along the segment, radius as a fraction of stature), by the joint they begin at."""
_TRUNK: dict[str, tuple[tuple[Vec, Vec, Colour], ...]] = {
    "pelvis": (((-0.002, 0, -0.008), (0.062, 0.096, 0.060), "joint"), ((0.0, 0, 0.032), (0.057, 0.086, 0.058), "body")),
    "spine1": (((0.002, 0, 0.030), (0.055, 0.080, 0.070), "body"),),
    "spine2": (((0.005, 0, 0.020), (0.060, 0.088, 0.078), "body"),),
    "spine3": (((0.0, 0, 0.040), (0.065, 0.102, 0.085), "body"),),
    "head": (((0.006, 0, 0.046), (0.052, 0.044, 0.063), "body"), ((0.049, 0, 0.054), (0.011, 0.032, 0.010), "joint")),
}
"""Ellipsoids of trunk and head: centre, half sizes (fractions of stature), colour."""


@dataclass(frozen=True)
class Part:
    """One solid of a joint's body.

    Attributes:
        kind: of solid.
        size_m: box and ellipsoid: half sizes; cylinder: radius and half length (along Z); sphere and capsule: radius;
            limb: the stature that `outline` is a fraction of.
        position_m: of its centre; the start of a limb or capsule is the joint.
        end_m: where a limb or capsule ends.
        outline: of a limb.
    """

    kind: Literal["box", "ellipsoid", "cylinder", "sphere", "capsule", "limb"]
    colour: Colour
    size_m: Vec
    position_m: Vec = (0.0, 0.0, 0.0)
    end_m: Vec = (0.0, 0.0, 0.0)
    outline: tuple[tuple[float, float], ...] = ()

    def mesh(self) -> Mesh:
        """The part as triangles in the joint's frame."""
        if self.kind == "limb":
            return limb(self.outline, self.end_m, self.size_m[0])
        if self.kind == "capsule":
            return capsule(self.size_m[0], (0.0, 0.0, 0.0), self.end_m)
        if self.kind == "box":
            solid = box(self.size_m)
        elif self.kind == "cylinder":
            solid = cylinder(self.size_m[0], self.size_m[1])
        else:
            solid = ellipsoid(self.size_m if self.kind == "ellipsoid" else self.size_m * 3)
        return solid.moved(self.position_m)


def parts_of(skeleton: Skeleton, joint: int) -> tuple[Part, ...]:
    """What is drawn for one joint; (nothing for a joint that only ends a segment)."""
    return tuple(_parts(skeleton, joint))


def _parts(skeleton: Skeleton, joint: int) -> Iterator[Part]:
    name, h = skeleton.names[joint], skeleton.height_m
    w = h * skeleton.girth
    side = name.partition("_")[0]
    part = name.removeprefix("left_").removeprefix("right_")
    colour: Colour = "left" if side == "left" else "right" if side == "right" else "body"
    if part in _OUTLINES:
        end = skeleton.offsets_m[skeleton.children(joint)[0]]
        tint: Colour = "body" if part == "collar" else "joint" if part == "neck" else colour
        yield Part("limb", tint, (w,), end_m=tuple(end.tolist()), outline=_OUTLINES[part])
    if part in ("hip", "knee", "shoulder", "elbow"):
        yield Part("sphere", "joint", (_OUTLINES[part][0][1] * 1.08 * w,))
    elif part == "ankle":
        yield from _foot(skeleton, joint, colour)
    elif part == "foot":
        length, drop = 0.036 * h, -0.0095 * h
        yield Part("box", colour, (length / 2, 0.026 * h, 0.0085 * h), (length / 2 - 0.002, 0, drop))
        yield Part("cylinder", colour, (0.026 * h, 0.0085 * h), (length - 0.002, 0, drop))
    elif part == "wrist":
        out = float(np.sign(skeleton.offsets_m[joint][1]))
        yield Part("ellipsoid", colour, (0.024 * h, 0.050 * h, 0.013 * h), (0, out * 0.042 * h, 0))
        yield Part("sphere", "joint", (0.0165 * h,))
    elif part in _TRUNK:
        for centre, half, tint in _TRUNK[part]:
            girth = (h, h, h) if part == "head" else (w, w, h)
            sizes = tuple(v * along for v, along in zip(half, girth, strict=True))
            yield Part("ellipsoid", tint, sizes, tuple(v * h for v in centre))


def _foot(skeleton: Skeleton, joint: int, colour: Colour) -> Iterator[Part]:
    """Heel and instep: from the heel behind the ankle to the ball of the foot."""
    h = skeleton.height_m
    toe = skeleton.offsets_m[skeleton.children(joint)[0]]
    sole = float(toe[2]) - 0.018 * h
    heel, thick = -0.030 * h, 0.0125 * h
    yield Part("box", colour, ((toe[0] - heel) / 2, 0.026 * h, thick), ((toe[0] + heel) / 2, 0.0, sole + thick))
    yield Part("cylinder", colour, (0.026 * h, thick), (heel, 0.0, sole + thick))
    yield Part("capsule", colour, (0.0225 * h,), end_m=(toe[0] * 0.72, 0.0, sole + 2.0 * thick))
    yield Part("sphere", "joint", (0.024 * h,))
