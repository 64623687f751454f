"""A trace that grows with every stretch of simulation, without being joined anew each time."""

from __future__ import annotations

from typing import Generic, TypeVar

import numpy as np
import numpy.typing as npt

from shared.motion.skeleton import CANONICAL
from shared.tasks.interface import Trace
from shared.tasks.world import World

T = TypeVar("T", bound=np.generic)
FIRST_ROWS = 256


class _Rows(Generic[T]):
    """Rows in one array that doubles when it is full. Views of what is there stay valid: rows are only added."""

    def __init__(self) -> None:
        self._data: npt.NDArray[T] | None = None
        self._count = 0

    def add(self, rows: npt.NDArray[T]) -> None:
        if self._data is None:
            self._data = np.empty((FIRST_ROWS, *rows.shape[1:]), rows.dtype)
        needed = self._count + len(rows)
        if needed > len(self._data):
            wider = np.empty((max(needed, 2 * len(self._data)), *rows.shape[1:]), self._data.dtype)
            wider[: self._count] = self.view()
            self._data = wider
        self._data[self._count : needed] = rows
        self._count = needed

    def view(self) -> npt.NDArray[T]:
        assert self._data is not None, "something was added"
        return self._data[: self._count]


class GrowingTrace:
    """Stretches that follow one another, as one Trace at any moment.

    Args:
        start_tick: of the first row; rows before it are left out.
    """

    def __init__(self, start_tick: int):
        self._start_tick = start_tick
        self._count = 0
        self._positions: _Rows[np.float64] = _Rows()
        self._fallen: _Rows[np.bool_] = _Rows()
        self._positions.add(np.zeros((0, len(CANONICAL), 3)))
        self._fallen.add(np.zeros(0, dtype=bool))
        self._objects: tuple[str, ...] | None = None
        self._world: dict[str, _Rows[np.float64]] = {"pose_w": _Rows(), "velocity_w": _Rows(), "impulse": _Rows()}
        self._contacts: dict[str, _Rows[np.int64]] = {"row": _Rows(), "body": _Rows(), "object": _Rows()}
        self._worldless = False
        self._felt = True

    def __len__(self) -> int:
        return self._count

    def add(self, part: Trace) -> None:
        """The next stretch."""
        new = part.since(self._start_tick)
        if not len(new):
            return
        self._positions.add(new.pos_w_m)
        self._fallen.add(new.fallen)
        self._add_world(new.world)
        self._count += len(new)

    def _add_world(self, world: World | None) -> None:
        known = self._objects if world is None or self._objects is not None else world.objects
        if world is None or world.objects != known:
            self._worldless = True
        if self._worldless or world is None:
            return
        self._objects, self._felt = known, self._felt and world.felt
        self._world["pose_w"].add(world.pose_w)
        self._world["velocity_w"].add(world.velocity_w)
        self._world["impulse"].add(world.contact_impulse_ns)
        self._contacts["row"].add(world.contact_row + self._count)
        self._contacts["body"].add(world.contact_body)
        self._contacts["object"].add(world.contact_object)

    def trace(self) -> Trace:
        """Everything so far, read-only; its world is None where a stretch came without, or the scene was another."""
        world = None
        if not self._worldless and self._objects is not None:
            world = World(
                self._objects, self._world["pose_w"].view(), self._world["velocity_w"].view(),
                self._contacts["row"].view(), self._contacts["body"].view(), self._contacts["object"].view(),
                self._world["impulse"].view(), self._felt,
            )  # fmt: skip
        return Trace(self._start_tick, self._positions.view(), self._fallen.view(), world)
