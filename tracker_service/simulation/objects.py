"""Moving an object of a scene while it runs."""

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt

from shared.errors import InvalidInputError
from shared.motion.rotations import matrix_from_quat, quat_conj, quat_mul
from shared.scenes.placing import pose_of
from tracker_service.simulation.scene import SceneModel
from tracker_service.simulation.scene_objects import OBJECT_PREFIX

Vector = tuple[float, ...] | None
Array = npt.NDArray[np.float64]


def set_object(
    scene: SceneModel,
    data: mujoco.MjData,
    name: str,
    position_w_m: Vector = None,
    quat_w: Vector = None,
    linvel_w_mps: Vector = None,
    angvel_w_radps: Vector = None,
) -> None:
    """Put an object somewhere and give it a velocity; what is None stays. A hinged one takes turn and rate only.

    Raises:
        InvalidInputError: no such object, or one that cannot move so; nothing is changed.
    """
    body = scene.body_of(name)
    model, number = scene.model, int(scene.object_ids[scene.object_names.index(name)])
    quat = None if quat_w is None else np.asarray(quat_w, dtype=np.float64) / np.linalg.norm(quat_w)
    if body.motion == "fixed":
        for field, value in (("linvel_w_mps", linvel_w_mps), ("angvel_w_radps", angvel_w_radps)):
            if value is not None:
                raise InvalidInputError(f"{name} is fixed", field=field, allowed="position_w_m and quat_w")
        mocap = int(model.body_mocapid[number])
        if position_w_m is not None:
            data.mocap_pos[mocap] = position_w_m
        if quat is not None:
            data.mocap_quat[mocap] = quat
    elif body.motion == "hinged":
        for field, value in (("position_w_m", position_w_m), ("linvel_w_mps", linvel_w_mps)):
            if value is not None:
                raise InvalidInputError(f"{name} hangs on a hinge", field=field, allowed="quat_w and angvel_w_radps")
        joint = model.joint(OBJECT_PREFIX + name)
        axis = np.asarray(model.jnt_axis[joint.id])
        if quat is not None:
            data.qpos[joint.qposadr[0]] = _turn_about(axis, quat_mul(quat_conj(pose_of(body)[3:]), quat))
        if angvel_w_radps is not None:
            mujoco.mj_kinematics(model, data)
            data.qvel[joint.dofadr[0]] = float(np.dot(data.xaxis[joint.id], angvel_w_radps))
    else:
        joint = model.joint(OBJECT_PREFIX + name)
        at, speed = int(joint.qposadr[0]), int(joint.dofadr[0])
        if position_w_m is not None:
            data.qpos[at : at + 3] = position_w_m
        if quat is not None:
            data.qpos[at + 3 : at + 7] = quat
        if linvel_w_mps is not None:
            data.qvel[speed : speed + 3] = linvel_w_mps
        if angvel_w_radps is not None:  # MuJoCo keeps it in the body's own frame
            turn = matrix_from_quat(data.qpos[at + 3 : at + 7])
            data.qvel[speed + 3 : speed + 6] = turn.T @ np.asarray(angvel_w_radps)
    mujoco.mj_forward(model, data)


def _turn_about(axis: Array, quat: Array) -> float:
    """The angle about a unit axis that comes nearest to a rotation, -pi to pi."""
    angle = 2.0 * np.arctan2(float(np.dot(quat[1:], axis)), float(quat[0]))
    return float((angle + np.pi) % (2 * np.pi) - np.pi)
