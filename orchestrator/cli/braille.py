"""Line drawings of a body in a terminal: braille characters hold two by four dots each."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from shared.motion.skeleton import CANONICAL

Array = npt.NDArray[np.floating]
_FIRST = 0x2800
_DOTS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))
"""Bit of each dot by row and column."""
_RADII_M = {"spine": 0.07, "collar": 0.05, "knee": 0.045, "ankle": 0.03}
"""How thick the segments that end in a joint are drawn; the others are thin."""
BONES = tuple((parent, joint) for joint, parent in enumerate(CANONICAL.parents) if parent >= 0)


class Canvas:
    """A grid of dots, `columns` by `rows` characters, that shows a piece of a plane.

    Args:
        centre_m: (2,) what is in the middle. metres: how wide the canvas is; dots are square.
    """

    def __init__(self, columns: int, rows: int, centre_m: npt.ArrayLike, metres: float):
        self._dots = np.zeros((rows * 4, columns * 2), dtype=bool)
        self._centre = np.asarray(centre_m, dtype=np.float64)
        self._scale = columns * 2 / metres

    def line(self, start_m: npt.ArrayLike, end_m: npt.ArrayLike) -> None:
        """A straight line between two points (2,), x to the right and y up."""
        start, end = self._place(start_m), self._place(end_m)
        count = int(np.abs(end - start).max()) + 2
        for share in np.linspace(0.0, 1.0, count):
            self._set(start + share * (end - start))

    def limb(self, start_m: npt.ArrayLike, end_m: npt.ArrayLike, radius_m: float) -> None:
        """A line as thick as a limb."""
        start, end = np.asarray(start_m, dtype=np.float64), np.asarray(end_m, dtype=np.float64)
        along = end - start
        across = np.array([-along[1], along[0]]) / max(float(np.linalg.norm(along)), 1e-9)
        for share in np.linspace(-1.0, 1.0, 2 * int(np.ceil(radius_m * self._scale)) + 1):
            self.line(start + share * radius_m * across, end + share * radius_m * across)

    def cross(self, at_m: npt.ArrayLike) -> None:
        """A small x at a point (2,)."""
        place = self._place(at_m)
        for step in (-2, -1, 0, 1, 2):
            self._set(place + step)
            self._set(place + np.array([step, -step]))

    def lines(self) -> list[str]:
        """One string a row."""
        rows, columns = self._dots.shape[0] // 4, self._dots.shape[1] // 2
        bits = np.zeros((rows, columns), dtype=int)
        for y, pair in enumerate(_DOTS):
            for x, bit in enumerate(pair):
                bits += bit * self._dots[y::4, x::2]
        return ["".join(chr(_FIRST + int(cell)) for cell in row) for row in bits]

    def _place(self, point_m: npt.ArrayLike) -> Array:
        x, y = (np.asarray(point_m, dtype=np.float64) - self._centre) * self._scale
        return np.array([x + self._dots.shape[1] / 2, self._dots.shape[0] / 2 - y])

    def _set(self, place: Array) -> None:
        column, row = int(np.floor(place[0])), int(np.floor(place[1]))
        if 0 <= row < self._dots.shape[0] and 0 <= column < self._dots.shape[1]:
            self._dots[row, column] = True


def side_view(positions_w_m: Array, heading_rad: float, columns: int = 22, rows: int = 16) -> list[str]:
    """The body (22, 3) seen from its right, walking to the right, with the floor below it."""
    forward = np.array([np.cos(heading_rad), np.sin(heading_rad)])
    flat = np.stack([(positions_w_m[:, :2] - positions_w_m[0, :2]) @ forward, positions_w_m[:, 2]], axis=-1)
    canvas = Canvas(columns, rows, (0.0, 1.0), 2.15 * columns / (rows * 2))
    _bones(canvas, flat)
    canvas.line((-9.0, 0.0), (9.0, 0.0))
    return canvas.lines()


def top_view(
    positions_w_m: Array, path_xy_m: Iterable[Array] = (), target_xy_m: Array | None = None, columns: int = 32,
    rows: int = 16, metres: float = 6.0,
) -> list[str]:  # fmt: skip
    """The floor from above, X up and Y to the left: the body (22, 3) in the middle, where it was, where it shall go."""
    centre = _from_above(positions_w_m[0, :2])
    canvas = Canvas(columns, rows, centre, metres)
    places = [_from_above(xy) for xy in path_xy_m]
    for start, end in zip(places[:-1], places[1:], strict=True):
        canvas.line(start, end)
    _bones(canvas, np.stack([_from_above(p[:2]) for p in positions_w_m]))
    if target_xy_m is not None:
        half = np.array([metres / 2, metres * rows / columns]) * 0.94
        canvas.cross(centre + np.clip(_from_above(target_xy_m) - centre, -half, half))
    return canvas.lines()


def _from_above(xy_m: Array) -> Array:
    return np.array([-xy_m[1], xy_m[0]])


def _bones(canvas: Canvas, flat: Array) -> None:
    for parent, joint in BONES:
        name = CANONICAL.names[joint]
        canvas.limb(flat[parent], flat[joint], next((r for part, r in _RADII_M.items() if part in name), 0.02))
    head = flat[CANONICAL.index("head")]
    up = head - flat[CANONICAL.index("neck")]
    canvas.limb(head + 0.2 * up, head + 1.2 * up, 0.07)
