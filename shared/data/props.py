"""What a clip needs beside the body: the seat that carries it, the point that a limb strikes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from shared.motion.body import Array, J, heading_rad

PELVIS_OVER_SEAT_M = 0.12
"""Height of the pelvis joint over the top of the seat that carries it."""

Vec3 = tuple[float, float, float]


@dataclass(frozen=True)
class Seat:
    """A seat in the frame of its clip.

    Attributes:
        top_m: centre of its top surface. heading_rad: where whoever sits on it looks.
        size_m: extent forward, across and down from the top.
    """

    top_m: Vec3
    heading_rad: float
    size_m: Vec3 = (0.40, 0.45, 0.06)

    def moved(self, yaw_rad: float, shift_m: Array) -> Seat:
        """The seat turned about the vertical through the origin, then shifted by (2,) metres."""
        x, y = _turned(self.top_m, yaw_rad)
        top = (x + float(shift_m[0]), y + float(shift_m[1]), self.top_m[2])
        return replace(self, top_m=top, heading_rad=self.heading_rad + yaw_rad)

    def mirrored(self) -> Seat:
        """The seat seen in a mirror at y = 0."""
        return replace(self, top_m=(self.top_m[0], -self.top_m[1], self.top_m[2]), heading_rad=-self.heading_rad)

    @classmethod
    def under(cls, p: Array, size_m: Vec3 = (0.40, 0.45, 0.06)) -> Seat:
        """The seat that carries a body which sits through all poses (T, 22, 3)."""
        at = np.median(p[:, J["pelvis"]], axis=0)
        heading = float(np.median(heading_rad(p)))
        return cls((float(at[0]), float(at[1]), float(at[2]) - PELVIS_OVER_SEAT_M), heading, size_m)


@dataclass(frozen=True)
class Strike:
    """A blow in the frame of its clip.

    Attributes:
        joint: what hits, such as `left_wrist` or `right_foot`. target_m: the point that it hits.
        frame: the frame of the clip (30 fps) in which it does.
    """

    joint: str
    target_m: Vec3
    frame: int

    def moved(self, yaw_rad: float, shift_m: Array) -> Strike:
        """The blow turned about the vertical through the origin, then shifted by (2,) metres."""
        x, y = _turned(self.target_m, yaw_rad)
        return replace(self, target_m=(x + float(shift_m[0]), y + float(shift_m[1]), self.target_m[2]))

    def mirrored(self) -> Strike:
        """The blow seen in a mirror at y = 0, by the other limb."""
        side, _, part = self.joint.partition("_")
        other = "right" if side == "left" else "left"
        return replace(self, joint=f"{other}_{part}", target_m=(self.target_m[0], -self.target_m[1], self.target_m[2]))


def _turned(point: Vec3, yaw_rad: float) -> tuple[float, float]:
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    return float(c * point[0] - s * point[1]), float(s * point[0] + c * point[1])


def seat_from(data: dict[str, Any] | None) -> Seat | None:
    """A seat as `dataclasses.asdict` and JSON leave it."""
    return None if data is None else Seat(tuple(data["top_m"]), data["heading_rad"], tuple(data["size_m"]))


def strike_from(data: dict[str, Any] | None) -> Strike | None:
    """A blow as `dataclasses.asdict` and JSON leave it."""
    return None if data is None else Strike(data["joint"], tuple(data["target_m"]), data["frame"])
