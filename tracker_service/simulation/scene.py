"""A scene's objects around the humanoid, as one MuJoCo model."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt

from shared.errors import InvalidInputError
from shared.scenes.schema import Scene, SceneBody
from tracker_service.simulation.humanoid import Humanoid, body_ids, humanoid_spec
from tracker_service.simulation.scene_objects import FLOOR_BIT, OBJECT_PREFIX, add_object


@dataclass(frozen=True)
class SceneModel:
    """The compiled world of one character.

    Attributes:
        model: MuJoCo's model; qpos begins with the humanoid's.
        body_ids: (J,) body id of each joint.
        object_names: names of all objects; object_ids: (O,) their body ids.
    """

    scene: Scene
    human: Humanoid
    model: mujoco.MjModel
    body_ids: npt.NDArray[np.int64]
    object_names: tuple[str, ...]
    object_ids: npt.NDArray[np.int64]

    def body_of(self, name: str) -> SceneBody:
        """The scene's body of that name; raises InvalidInputError listing the names."""
        body = self.scene.body(name)
        if body is None:
            known = ", ".join(self.object_names) or "none, the scene is empty"
            raise InvalidInputError(f"unknown object {name!r}", field="name", allowed=known)
        return body


def build_scene(human: Humanoid, scene: Scene) -> SceneModel:
    """Compile the humanoid and a scene's objects; objects collide with the humanoid, the floor and each other."""
    spec = humanoid_spec(human)
    spec.geom("floor").contype |= FLOOR_BIT
    # What has an area to sit or stand on is seen by the rays for heights even if it can be pushed about: a chair.
    seats = {mark.body for mark in scene.marks.values() if mark.half_size_m is not None}
    for item in scene.bodies:
        add_object(spec, item, item.name in seats)
    model = spec.compile()
    names = tuple(item.name for item in scene.bodies)
    ids = np.array([model.body(OBJECT_PREFIX + name).id for name in names], dtype=np.int64)
    return SceneModel(scene, human, model, body_ids(model, human.skeleton), names, ids)
