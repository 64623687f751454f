"""How a scene looks, without MuJoCo: so that the drawn renderer needs no graphics library."""

from __future__ import annotations

from dataclasses import dataclass

Vec = tuple[float, ...]
OBJECT_RGBA = (0.62, 0.45, 0.34, 1.0)


@dataclass(frozen=True)
class SceneShape:
    """One shape of a scene object, in MuJoCo's terms.

    Attributes:
        body: name of the object it belongs to (its pose is in the log), or None for a shape fixed in the world.
        kind: `box`, `capsule`, `cylinder`, `sphere` or `ellipsoid`.
        size_m: MuJoCo half sizes (box: 3, capsule and cylinder: radius and half length, sphere: radius).
        pos_b_m, quat_b: pose in the object (in the world when it is fixed).
        rgba: colour.
    """

    body: str | None
    kind: str
    size_m: Vec
    pos_b_m: Vec = (0.0, 0.0, 0.0)
    quat_b: Vec = (1.0, 0.0, 0.0, 0.0)
    rgba: Vec = OBJECT_RGBA
