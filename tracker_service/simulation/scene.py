"""A scene's objects around the humanoid, as one MuJoCo model."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt

from shared.scenes.schema import Scene
from tracker_service.simulation.humanoid import BODY_BIT, WORLD_BIT, Humanoid, body_ids, humanoid_spec

_SHAPES = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
}
OBJECT_PREFIX = "object_"


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


def build_scene(human: Humanoid, scene: Scene) -> SceneModel:
    """Compile the humanoid and a scene's objects; objects collide with the humanoid, the floor and each other."""
    spec = humanoid_spec(human)
    for item in scene.bodies:
        half = np.deg2rad(item.heading_deg) / 2
        body = spec.worldbody.add_body(
            name=OBJECT_PREFIX + item.name, pos=list(item.position_w_m), quat=[np.cos(half), 0, 0, np.sin(half)]
        )
        if item.mass_kg is not None:
            body.add_freejoint(name=OBJECT_PREFIX + item.name)
        body.add_geom(
            name=OBJECT_PREFIX + item.name,
            type=_SHAPES[item.shape],
            size=[*item.size_m, 0.0, 0.0][:3],
            mass=item.mass_kg if item.mass_kg is not None else 1.0,
            friction=[item.friction, 0.005, 0.0001],
            contype=WORLD_BIT | BODY_BIT,
            conaffinity=WORLD_BIT | BODY_BIT,
            rgba=[0.62, 0.45, 0.34, 1],
        )
    model = spec.compile()
    names = tuple(item.name for item in scene.bodies)
    ids = np.array([model.body(OBJECT_PREFIX + name).id for name in names], dtype=np.int64)
    return SceneModel(scene, human, model, body_ids(model, human.skeleton), names, ids)
