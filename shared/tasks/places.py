"""Where a scene's marks are for a task: now, and at every tick of a trace."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.errors import InvalidInputError
from shared.motion.heading import heading_of
from shared.motion.rotations import matrix_from_quat
from shared.scenes.placing import Place, mark_place
from shared.scenes.schema import Mark, Scene
from shared.tasks.interface import BodyView
from shared.tasks.world import World

Array = npt.NDArray[np.float64]
USUAL_HALF_SIZE_M = (0.2, 0.2)
"""Of a seat whose mark has no area."""


def check_mark(scene: Scene | None, name: str, on_object: bool = False) -> None:
    """Raise InvalidInputError, with the marks there are, where the scene has no such mark (on an object)."""
    if scene is None:
        return
    allowed = ", ".join(key for key, mark in scene.marks.items() if mark.body or not on_object)
    if name not in scene.marks:
        raise InvalidInputError(
            f"scene {scene.name!r} has no mark {name!r}", field="mark", allowed=allowed or "a scene with marks"
        )
    if on_object and scene.marks[name].body is None:
        raise InvalidInputError(f"mark {name!r} is on no object", field="mark", allowed=allowed)


@dataclass(frozen=True)
class MarkedObject:
    """A mark on an object of a scene.

    Attributes:
        scene: as its seed made it. name: of the mark.
    """

    scene: Scene
    name: str

    @property
    def mark(self) -> Mark:
        """As the scene has it."""
        return self.scene.marks[self.name]

    @property
    def object(self) -> str:
        """The object it is on."""
        return str(self.mark.body)

    @property
    def half_size_m(self) -> tuple[float, float]:
        """Half sizes of its area along and across the way one faces there."""
        return self.mark.half_size_m or USUAL_HALF_SIZE_M

    def place(self, view: BodyView, name: str | None = None) -> Place:
        """Where it (or another mark) is now."""
        mark = self.scene.marks[name or self.name]
        return mark_place(self.scene, name or self.name, view.objects.get(mark.body or ""))

    def local_m(self, world: World, points_w_m: Array) -> Array:
        """Points (T, 3) as the mark sees them at each tick: ahead, left, above; heights along the world's Z."""
        pose = world.pose_w[:, world.objects.index(self.object)]
        turn = matrix_from_quat(pose[:, 3:])
        centre = pose[:, :3] + turn @ np.array(self.mark.position_b_m, dtype=np.float64)
        angle = np.deg2rad(self.mark.heading_deg)
        faces = turn @ np.array([np.cos(angle), np.sin(angle), 0.0])
        heading = heading_of(faces)
        away, cos, sin = points_w_m - centre, np.cos(heading), np.sin(heading)
        return np.stack([away[:, 0] * cos + away[:, 1] * sin, away[:, 1] * cos - away[:, 0] * sin, away[:, 2]], axis=-1)


def marked_object(view: BodyView, name: str) -> MarkedObject:
    """A mark of the scene that a task was started in.

    Raises:
        InvalidInputError: there is no such mark on an object, or the scene is not known.
    """
    if view.scene is None:
        raise InvalidInputError("the task needs a scene with marks", field="scene", allowed="a scene that is known")
    check_mark(view.scene, name, on_object=True)
    return MarkedObject(view.scene, name)
