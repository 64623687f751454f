"""Room for a body among the objects of a scene. Pure functions."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from shared.scenes.schema import Scene

Array = npt.NDArray[np.float64]
RING_M, FARTHEST_M, DIRECTIONS = 0.05, 4.0, 48


def clear_of(scene: Scene, xy_m: npt.ArrayLike, room_m: float) -> Array:
    """(2,) the place, or about the nearest one that is `room_m` from every object where the scene has it.

    What counts as ground stands in nobody's way. Parts are taken as upright blocks. Where everything within 4 m is
    full, the place itself.
    """
    place = np.array(xy_m, dtype=np.float64)
    angles = np.arange(DIRECTIONS) * 2 * np.pi / DIRECTIONS
    ways = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    rings = np.arange(0.0, FARTHEST_M, RING_M)
    points = place + (rings[:, None, None] * ways).reshape(-1, 2)  # nearest first
    free = np.ones(len(points), dtype=bool)
    for body in scene.bodies:
        angle = np.deg2rad(body.heading_deg)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        for part in () if body.ground else body.parts:
            half = np.array(part.size_m[:2] if part.shape == "box" else [part.size_m[0]] * 2)
            if any(part.rotation_deg):
                half = np.full(2, sum(part.size_m))  # whichever way it is turned, it reaches no farther
            away = (points - body.position_w_m[:2]) @ turn - np.array(part.position_b_m[:2])
            free &= (np.abs(away) >= half + room_m).any(axis=1)
    return np.asarray(points[int(np.argmax(free))])
