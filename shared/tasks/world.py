"""What is around the body in a trace: the scene's objects at every tick, and what the body touched."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.errors import InvalidInputError
from shared.motion.rotations import matrix_from_quat
from shared.motion.skeleton import CANONICAL
from shared.protocol.messages import FLOOR

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
THE_FLOOR = "floor"


@dataclass(frozen=True)
class World:
    """T ticks of a scene with O objects, and C contacts of the body, as the tracker logged them (world frame).

    Attributes:
        objects: names.
        pose_w: (T, O, 7) position and quaternion wxyz. velocity_w: (T, O, 6) linear and angular.
        contact_row: (C,) row of the trace, in rising order; contact_body: (C,) joint; contact_object: (C,) index into
            `objects`, -1 for the floor; contact_impulse_ns: (C,) normal impulse within that tick.
        felt: False where touches cannot be told, as in a plan: what a rule asks of them is then taken as given.
    """

    objects: tuple[str, ...]
    pose_w: Array
    velocity_w: Array
    contact_row: IntArray
    contact_body: IntArray
    contact_object: IntArray
    contact_impulse_ns: Array
    felt: bool = True

    def position_m(self, name: str) -> Array:
        """(T, 3) where an object was; raises InvalidInputError listing the names."""
        return self.pose_w[:, self._index(name), :3]

    def axis(self, name: str) -> Array:
        """(T, 3) the way an object's own Z pointed; raises InvalidInputError listing the names."""
        return matrix_from_quat(self.pose_w[:, self._index(name), 3:])[..., 2]

    def impulse_ns(self, name: str, joints: Sequence[str] | None = None) -> Array:
        """(T,) normal impulse at every tick between some joints' bodies (None: any) and an object, or the `floor`.

        Divided by the length of a tick it is the mean force, so that a seat's share of the weight can be told.
        """
        of = FLOOR if name == THE_FLOOR else self._index(name)
        wanted = self.contact_object == of
        if joints is not None:
            wanted &= np.isin(self.contact_body, CANONICAL.indices(*joints))
        rows, impulses = self.contact_row[wanted], self.contact_impulse_ns[wanted]
        return np.bincount(rows, impulses, minlength=len(self.pose_w)).astype(np.float64)

    def rows(self, start: int, stop: int | None = None) -> World:
        """Rows start..stop-1 as a world of their own."""
        pose = self.pose_w[start:stop]
        kept = (self.contact_row >= start) & (self.contact_row < start + len(pose))
        return World(
            self.objects, pose, self.velocity_w[start:stop], self.contact_row[kept] - start, self.contact_body[kept],
            self.contact_object[kept], self.contact_impulse_ns[kept], self.felt,
        )  # fmt: skip

    def _index(self, name: str) -> int:
        if name not in self.objects:
            raise InvalidInputError(
                f"there is no object {name!r}", field="object", allowed=", ".join(self.objects) or "an empty scene"
            )
        return self.objects.index(name)


def unfelt(objects: Mapping[str, Array], ticks: int) -> World:
    """A world of so many ticks in which objects stay at (7,) poses and touches cannot be told."""
    nothing = np.zeros(0, dtype=np.int64)
    pose = np.array(list(objects.values()), dtype=np.float64).reshape(len(objects), 7)
    still = np.zeros((ticks, len(objects), 6))
    return World(
        tuple(objects), np.repeat(pose[None], ticks, axis=0), still, nothing, nothing, nothing, np.zeros(0), felt=False
    )


def worlds_joined(parts: Sequence[World | None]) -> World | None:
    """Worlds of traces that follow one another as one; None where one is missing or the objects are others."""
    known = [part for part in parts if part is not None]
    if not known or len(known) < len(parts) or any(part.objects != known[0].objects for part in known):
        return None
    starts = np.cumsum([0, *(len(part.pose_w) for part in known[:-1])])
    return World(
        known[0].objects,
        np.concatenate([part.pose_w for part in known]),
        np.concatenate([part.velocity_w for part in known]),
        np.concatenate([part.contact_row + start for part, start in zip(known, starts, strict=True)]),
        np.concatenate([part.contact_body for part in known]),
        np.concatenate([part.contact_object for part in known]),
        np.concatenate([part.contact_impulse_ns for part in known]),
        all(part.felt for part in known),
    )
