"""The characters there are, as data: which skeleton and what weight; and how canonical motion becomes theirs.

Plans are made for the canonical skeleton, whose world is the character's world divided by one factor, the ratio of hip
heights: every point, length and speed is, and angles and times stay. So targets, keyframes, obstacles and seats scale
with the character, feet meet the same floor, and a plan that fits the canonical skeleton fits the character's bones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.errors import InvalidInputError
from shared.motion.skeleton import CANONICAL, Skeleton, skeleton

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Build:
    """A character of the registry.

    Attributes:
        name: as in CreateCharacter. skeleton_id: see shared.motion.skeleton. mass_kg: of the whole body.
    """

    name: str
    skeleton_id: str
    mass_kg: float

    @property
    def skeleton(self) -> Skeleton:
        """Its skeleton."""
        return skeleton(self.skeleton_id)

    @property
    def world_scale(self) -> float:
        """Lengths in its world = lengths in the canonical skeleton's world times this; exactly 1 for `human`."""
        return self.skeleton.root_height_m / CANONICAL.root_height_m

    def to_canonical(self, lengths: npt.ArrayLike) -> Array:
        """Points, lengths or velocities of its world as the canonical skeleton's world has them; any shape."""
        return np.asarray(lengths, dtype=np.float64) / self.world_scale

    def from_canonical(self, lengths: npt.ArrayLike) -> Array:
        """The way back: a plan for the canonical skeleton (T, J, 3) becomes one for this one, over the same floor."""
        return np.asarray(lengths, dtype=np.float64) * self.world_scale


BUILDS = {
    build.name: build
    for build in (Build("human", CANONICAL.id, 72.0), Build("child", "child22", 25.0), Build("heavy", "heavy22", 130.0))
}


def build(name: str) -> Build:
    """The character of that name; raises InvalidInputError listing the known ones."""
    if name not in BUILDS:
        raise InvalidInputError(f"unknown character {name!r}", field="character", allowed=", ".join(BUILDS))
    return BUILDS[name]
