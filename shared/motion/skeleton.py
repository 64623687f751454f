"""Skeletons as data. The canonical one has HumanML3D's 22 joints and is 1.75 m tall.

Axes: X forward, Y left, Z up (right-handed). The rest pose is a T-pose in which every joint frame is
aligned with the world, so an identity rotation everywhere is the T-pose facing +X.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from shared.errors import InvalidInputError

FloatArray = npt.NDArray[np.floating]


@dataclass(frozen=True)
class Skeleton:
    """A tree of joints.

    Attributes:
        id: name that travels with every clip.
        names: (J,) joint names; a parent always precedes its children.
        parents: (J,) index of each joint's parent, -1 for the root.
        offsets_m: (J, 3) rest offset of each joint from its parent (metres); zero for the root.
        root_height_m: height of the root above the floor in the rest pose.
        height_m: stature.
        girth: how much thicker the body is than is usual for the stature.
    """

    id: str
    names: tuple[str, ...]
    parents: tuple[int, ...]
    offsets_m: npt.NDArray[np.float64]
    root_height_m: float
    height_m: float
    girth: float = 1.0

    def __post_init__(self) -> None:
        n = len(self.names)
        if len(self.parents) != n or self.offsets_m.shape != (n, 3):
            raise InvalidInputError(
                f"skeleton {self.id!r}: {n} names, {len(self.parents)} parents and offsets of shape "
                f"{self.offsets_m.shape} do not belong together",
                field="offsets_m",
                allowed=f"shape ({n}, 3)",
            )
        if any(parent >= child for child, parent in enumerate(self.parents)):
            raise InvalidInputError(f"skeleton {self.id!r}: a parent must precede its children", field="parents")
        self.offsets_m.setflags(write=False)

    def __len__(self) -> int:
        return len(self.names)

    def index(self, name: str) -> int:
        """Index of the joint called `name`; raises InvalidInputError listing the valid names."""
        try:
            return self.names.index(name)
        except ValueError:
            raise InvalidInputError(f"unknown joint {name!r}", field="joint", allowed=", ".join(self.names)) from None

    def indices(self, *names: str) -> npt.NDArray[np.int64]:
        """Indices of several joints, (len(names),)."""
        return np.array([self.index(name) for name in names])

    def children(self, joint: int) -> tuple[int, ...]:
        """Indices of the joints whose parent is `joint`."""
        return tuple(c for c, p in enumerate(self.parents) if p == joint)

    @cached_property
    def bone_lengths_m(self) -> npt.NDArray[np.float64]:
        """(J,) length of the bone that ends in each joint; zero for the root."""
        return np.asarray(np.linalg.norm(self.offsets_m, axis=-1))

    @cached_property
    def rest_positions_m(self) -> npt.NDArray[np.float64]:
        """(J, 3) joint positions of the T-pose standing on the floor at the origin, facing +X."""
        out = np.zeros((len(self), 3))
        out[0, 2] = self.root_height_m
        for joint in range(1, len(self)):
            out[joint] = out[self.parents[joint]] + self.offsets_m[joint]
        return out

    @cached_property
    def mirror_map(self) -> npt.NDArray[np.int64]:
        """(J,) index of the joint on the other side (itself on the midline)."""

        def other(name: str) -> str:
            if name.startswith("left_"):
                return "right_" + name.removeprefix("left_")
            return "left_" + name.removeprefix("right_") if name.startswith("right_") else name

        return np.array([self.index(other(name)) for name in self.names])


# Stature 1.75 m. Segment lengths after Drillis & Contini (1966) as tabulated by Winter, "Biomechanics and Motor
# Control of Human Movement": thigh .245 H, shank .246 H, ankle height .039 H, upper arm .186 H, forearm .146 H,
# shoulder height .818 H, foot .152 H. Hip and spine joint centres after de Leva (1996), rounded to 5 mm.
_CANONICAL: tuple[tuple[str, str | None, tuple[float, float, float]], ...] = (
    ("pelvis", None, (0.0, 0.0, 0.0)),
    ("left_hip", "pelvis", (0.0, 0.0875, -0.065)),
    ("right_hip", "pelvis", (0.0, -0.0875, -0.065)),
    ("spine1", "pelvis", (-0.02, 0.0, 0.105)),
    ("left_knee", "left_hip", (0.0, 0.0, -0.4288)),
    ("right_knee", "right_hip", (0.0, 0.0, -0.4288)),
    ("spine2", "spine1", (0.005, 0.0, 0.13)),
    ("left_ankle", "left_knee", (0.0, 0.0, -0.4305)),
    ("right_ankle", "right_knee", (0.0, 0.0, -0.4305)),
    ("spine3", "spine2", (0.015, 0.0, 0.06)),
    ("left_foot", "left_ankle", (0.135, 0.0, -0.05)),
    ("right_foot", "right_ankle", (0.135, 0.0, -0.05)),
    ("neck", "spine3", (-0.02, 0.0, 0.205)),
    ("left_collar", "spine3", (0.0, 0.07, 0.115)),
    ("right_collar", "spine3", (0.0, -0.07, 0.115)),
    ("head", "neck", (0.03, 0.0, 0.095)),
    ("left_shoulder", "left_collar", (-0.01, 0.12, 0.03)),
    ("right_shoulder", "right_collar", (-0.01, -0.12, 0.03)),
    ("left_elbow", "left_shoulder", (0.0, 0.3255, 0.0)),
    ("right_elbow", "right_shoulder", (0.0, -0.3255, 0.0)),
    ("left_wrist", "left_elbow", (0.0, 0.2555, 0.0)),
    ("right_wrist", "right_elbow", (0.0, -0.2555, 0.0)),
)


def _canonical() -> Skeleton:
    names = tuple(name for name, _, _ in _CANONICAL)
    parents = tuple(-1 if parent is None else names.index(parent) for _, parent, _ in _CANONICAL)
    offsets = np.array([offset for _, _, offset in _CANONICAL])
    root_height = 0.065 + 0.4288 + 0.4305 + 0.039 * 1.75
    return Skeleton("human22", names, parents, offsets, root_height, 1.75)


CANONICAL = _canonical()
"""The skeleton of the corpus, of DiP and of the character `human` (DESIGN 2)."""


def scaled(base: Skeleton, skeleton_id: str, height_m: float, girth: float = 1.0) -> Skeleton:
    """The same body larger or smaller as a whole: every length times height_m / base.height_m."""
    factor = height_m / base.height_m
    return Skeleton(
        skeleton_id, base.names, base.parents, base.offsets_m * factor, base.root_height_m * factor, height_m, girth
    )


SKELETONS = {
    bones.id: bones
    for bones in (CANONICAL, scaled(CANONICAL, "child22", 1.2, 1.04), scaled(CANONICAL, "heavy22", 1.9, 1.19))
}
"""The skeletons of the characters (`shared.motion.characters`), all with the canonical one's joints."""


def skeleton(skeleton_id: str) -> Skeleton:
    """Skeleton by id; raises InvalidInputError listing the known ones."""
    if skeleton_id not in SKELETONS:
        raise InvalidInputError(f"unknown skeleton {skeleton_id!r}", field="skeleton", allowed=", ".join(SKELETONS))
    return SKELETONS[skeleton_id]
