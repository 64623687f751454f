"""What a tracker is shown of the scene: the nearest primitives, and heights of ground and seats by casting rays."""

from __future__ import annotations

from typing import TypedDict

import mujoco
import numpy as np
import numpy.typing as npt

from shared.motion.rotations import cross, matrix_from_quat, quat_mul
from shared.plugins.interfaces import GROUND_GRID_M, NEAR_OBJECT_M, NEAR_OBJECTS
from shared.scenes.schema import Part
from tracker_service.simulation.scene import SceneModel
from tracker_service.simulation.scene_objects import GROUND_GROUP, SURFACE_GROUP

Array = npt.NDArray[np.float64]
_DOWN = np.array([0.0, 0.0, -1.0])


class Surroundings(TypedDict, total=False):
    """Fields of a TrackerObservation; absent ones keep their zeros."""

    near_mask: Array
    near_pos_w_m: Array
    near_quat_w: Array
    near_half_size_m: Array
    near_linvel_w_mps: Array
    ground_height_w_m: Array
    foot_height_w_m: Array
    seat_height_w_m: Array


class Heights:
    """Heights of the topmost surface of fixed objects and seats below a point; 0 where only the floor is.

    Args:
        scene: whose objects there are.
    """

    def __init__(self, scene: SceneModel):
        self._model = scene.model
        group = np.asarray(scene.model.geom_group)
        self.any_surface = bool(np.isin(group, (SURFACE_GROUP, GROUND_GROUP)).any())
        self._any_ground = bool((group == GROUND_GROUP).any())
        self._ground = _groups(GROUND_GROUP)
        self._surfaces = _groups(SURFACE_GROUP, GROUND_GROUP)

    def ground_m(self, data: mujoco.MjData, below_w_m: Array) -> float:
        """Of what counts as ground, below a point (3,)."""
        return self._cast(data, below_w_m, self._ground) if self._any_ground else 0.0

    def surfaces_m(self, data: mujoco.MjData, below_w_m: Array) -> Array:
        """(N,) of ground and seats, below points (N, 3)."""
        if not self.any_surface:
            return np.zeros(len(below_w_m))
        return np.array([self._cast(data, point, self._surfaces) for point in below_w_m])

    def _cast(self, data: mujoco.MjData, point: Array, groups: npt.NDArray[np.uint8]) -> float:
        hit = np.zeros(1, dtype=np.int32)
        way = mujoco.mj_ray(self._model, data, np.ascontiguousarray(point), _DOWN, groups, True, -1, hit)
        return max(0.0, float(point[2] - way)) if way >= 0 else 0.0


class Sight:
    """Fills in what an observation has of the scene.

    Args:
        scene: whose objects there are. heights: of the same scene.
    """

    def __init__(self, scene: SceneModel, heights: Heights):
        skeleton = scene.human.skeleton
        self._heights = heights
        self._feet = skeleton.indices("left_foot", "right_foot")
        parts = [(o, part) for o, body in enumerate(scene.scene.bodies) for part in body.parts]
        self._object = np.array([o for o, _ in parts], dtype=np.int64)
        self._pos_b = np.array([part.position_b_m for _, part in parts]).reshape(-1, 3)
        self._quat_b = np.array([part.quat_b for _, part in parts]).reshape(-1, 4)
        self._half = np.array([_half_size(part) for _, part in parts]).reshape(-1, 3)

    def of(
        self, data: mujoco.MjData, body_pos_w_m: Array, forward_w: Array, pose_w: Array, vel_w: Array
    ) -> Surroundings:
        """What is around a character now.

        Args:
            body_pos_w_m: (J, 3). forward_w: (3,) the pelvis' X axis.
            pose_w: (O, 7) and vel_w: (O, 6) of the objects' frames.
        """
        out = Surroundings()
        if len(self._object):
            out.update(self._near(body_pos_w_m[0], pose_w, vel_w))
        if self._heights.any_surface:
            out.update(self._under(data, body_pos_w_m, forward_w))
        return out

    def _near(self, pelvis: Array, pose_w: Array, vel_w: Array) -> Surroundings:
        frame = matrix_from_quat(pose_w[:, 3:])[self._object]
        arm = (frame @ self._pos_b[..., None])[..., 0]
        pos = pose_w[self._object, :3] + arm
        quat = quat_mul(pose_w[self._object, 3:], self._quat_b)
        offset = (matrix_from_quat(quat).swapaxes(-1, -2) @ (pelvis - pos)[..., None])[..., 0]
        distance = np.linalg.norm(np.maximum(np.abs(offset) - self._half, 0.0), axis=-1)
        order = np.argsort(distance, kind="stable")[:NEAR_OBJECTS]
        order = order[distance[order] <= NEAR_OBJECT_M]
        velocity = vel_w[self._object, :3] + cross(vel_w[self._object, 3:], arm)

        def rows(values: Array) -> Array:
            out = np.zeros((NEAR_OBJECTS, *values.shape[1:]))
            out[: len(order)] = values[order]
            return out

        return Surroundings(
            near_mask=rows(np.ones(len(self._object))),
            near_pos_w_m=rows(pos),
            near_quat_w=rows(quat),
            near_half_size_m=rows(self._half),
            near_linvel_w_mps=rows(velocity),
        )

    def _under(self, data: mujoco.MjData, body_pos_w_m: Array, forward_w: Array) -> Surroundings:
        pelvis = body_pos_w_m[0]
        ahead = forward_w[:2] / max(float(np.hypot(*forward_w[:2])), 1e-6)
        left = np.array([-ahead[1], ahead[0]])
        grid = [pelvis[:2] + x * ahead + y * left for x in GROUND_GRID_M for y in GROUND_GRID_M]
        points = np.array([*grid, *body_pos_w_m[self._feet, :2], pelvis[:2]])
        heights = self._heights.surfaces_m(data, np.column_stack([points, np.full(len(points), pelvis[2])]))
        count = len(grid)
        return Surroundings(
            ground_height_w_m=heights[:count],
            foot_height_w_m=heights[count : count + 2],
            seat_height_w_m=heights[count + 2 :],
        )


def _half_size(part: Part) -> tuple[float, ...]:
    """Half the edges of a primitive's box along its own axes."""
    size = part.size_m
    if part.shape == "box":
        return size
    if part.shape == "sphere":
        return size * 3
    return size[0], size[0], size[1] + (size[0] if part.shape == "capsule" else 0.0)


def _groups(*shown: int) -> npt.NDArray[np.uint8]:
    out = np.zeros(6, dtype=np.uint8)
    out[list(shown)] = 1
    return out
