"""Shadows on the floor, as flattened dark copies of what stands on it.

A shadow map costs a software renderer two more passes over the scene and a look-up at every pixel. The copies cost a
few triangles; they fall on the floor only, not on other bodies.
"""

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt

from tracker_service.rendering.mannequin import KEY_LIGHT_DIR

SHADOW_RGBA = np.array([0.36, 0.39, 0.43, 1.0], dtype=np.float32)
LIFT_M = 0.003
"""Height above the floor, so that the floor does not shine through."""
THICKNESS = 0.001
"""What is left of heights: more than nothing, since the normals of a flat copy would be undefined."""
SMALLEST_M = 0.03
"""Bodies of smaller extent (joint balls) lie in the shadow of larger ones."""


def floor_projection(direction: tuple[float, float, float] = KEY_LIGHT_DIR) -> npt.NDArray[np.float64]:
    """(3, 3) matrix that moves points along the light onto the floor, but for THICKNESS of their height."""
    x, y, z = direction
    return np.array([[1.0, 0.0, -x / z], [0.0, 1.0, -y / z], [0.0, 0.0, THICKNESS]])


class FloorShadows:
    """Adds the shadows of a scene's geoms to the scene, anew for every frame.

    Args:
        scene: whose plane, the floor, is at height zero.
    """

    def __init__(self, scene: mujoco.MjvScene):
        self._scene = scene
        self._projection = floor_projection()

    def cast(self) -> None:
        """Add the shadows of the geoms that the scene now has."""
        scene, count = self._scene, self._scene.ngeom
        for i in range(count):
            geom = scene.geoms[i]
            if geom.type == mujoco.mjtGeom.mjGEOM_PLANE or scene.ngeom >= scene.maxgeom:
                continue
            if geom.type != mujoco.mjtGeom.mjGEOM_MESH and geom.size.max() < SMALLEST_M:
                continue
            pos = self._projection @ geom.pos
            pos[2] += LIFT_M
            shadow = scene.geoms[scene.ngeom]
            mujoco.mjv_initGeom(
                shadow, geom.type, geom.size.astype(np.float64), pos, (self._projection @ geom.mat).ravel(), SHADOW_RGBA
            )
            shadow.size[:] = geom.size  # already as the scene has it: of a cylinder radius, radius, half length
            shadow.dataid, shadow.specular, shadow.category = geom.dataid, 0.0, geom.category
            scene.ngeom += 1
