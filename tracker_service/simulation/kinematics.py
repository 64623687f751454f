"""Body positions, rotations and velocities from generalised coordinates, for a whole batch at once (numpy).

qpos = [root position 3, root quaternion wxyz 4, hinges H], qvel = [root velocity in world 3, root angular velocity in
the body's frame 3, hinge rates H], as MuJoCo has them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.motion.rotations import cross, matrix_from_quat, quat_from_matrix
from tracker_service.simulation.humanoid import Humanoid

Array = npt.NDArray[np.floating]


@dataclass(frozen=True)
class BodyStates:
    """World-frame states of J bodies.

    Attributes:
        pos_w_m: (..., J, 3) joint positions. rot_w: (..., J, 3, 3).
        linvel_w_mps: (..., J, 3) velocity of the joint's point. angvel_w_radps: (..., J, 3).
    """

    pos_w_m: Array
    rot_w: Array
    linvel_w_mps: Array
    angvel_w_radps: Array


class BodyKinematics:
    """Forward kinematics of a humanoid, level by level of its tree."""

    def __init__(self, human: Humanoid):
        skeleton = human.skeleton
        self._hinges = human.hinges
        self._axes = human.hinges.axes
        self._offsets = skeleton.offsets_m
        depth = np.zeros(len(skeleton), dtype=int)
        for joint in range(1, len(skeleton)):
            depth[joint] = depth[skeleton.parents[joint]] + 1
        parents = np.array(skeleton.parents)
        self._levels = [(np.flatnonzero(depth == d), parents[depth == d]) for d in range(1, int(depth.max()) + 1)]

    def states(self, qpos: Array, qvel: Array) -> BodyStates:
        """Body states of qpos (B, 7+H) and qvel (B, 6+H), in the dtype of qpos."""
        dtype = qpos.dtype
        batch = qpos.shape[0]
        joints = self._offsets.shape[0]
        local = self._hinges.rotations(qpos[:, 7:])  # (B, J-1, 3, 3)
        rates = self._hinges.slots(qvel[:, 6:])
        q = self._hinges.slots(qpos[:, 7:])
        rel = self._relative_angular_velocity(q, rates)  # in the parent's frame
        offsets = self._offsets.astype(dtype)
        pos = np.empty((batch, joints, 3), dtype)
        rot = np.empty((batch, joints, 3, 3), dtype)
        lin = np.empty((batch, joints, 3), dtype)
        ang = np.empty((batch, joints, 3), dtype)
        pos[:, 0] = qpos[:, :3]
        rot[:, 0] = matrix_from_quat(qpos[:, 3:7])
        lin[:, 0] = qvel[:, :3]
        ang[:, 0] = (rot[:, 0] @ qvel[:, 3:6, None])[..., 0]
        for children, parents in self._levels:
            parent_rot = rot[:, parents]
            arm = (parent_rot @ offsets[children][..., None])[..., 0]
            pos[:, children] = pos[:, parents] + arm
            rot[:, children] = parent_rot @ local[:, children - 1]
            parent_ang = ang[:, parents]
            lin[:, children] = lin[:, parents] + cross(parent_ang, arm)
            ang[:, children] = parent_ang + (parent_rot @ rel[:, children - 1, :, None])[..., 0]
        return BodyStates(pos, rot, lin, ang)

    def poses(self, qpos: Array) -> tuple[Array, Array]:
        """Positions (B, J, 3) and rotations (B, J, 3, 3) of qpos (B, 7+H): `states` without the velocities."""
        dtype = qpos.dtype
        local = self._hinges.rotations(qpos[:, 7:])
        offsets = self._offsets.astype(dtype)
        pos = np.empty((len(qpos), len(offsets), 3), dtype)
        rot = np.empty((len(qpos), len(offsets), 3, 3), dtype)
        pos[:, 0] = qpos[:, :3]
        rot[:, 0] = matrix_from_quat(qpos[:, 3:7])
        for children, parents in self._levels:
            parent_rot = rot[:, parents]
            pos[:, children] = pos[:, parents] + (parent_rot @ offsets[children][..., None])[..., 0]
            rot[:, children] = parent_rot @ local[:, children - 1]
        return pos, rot

    def _relative_angular_velocity(self, q: Array, rates: Array) -> Array:
        """Angular velocity (B, J-1, 3) of each joint relative to its parent, in the parent's frame."""
        sa, ca = np.sin(q[..., 0]), np.cos(q[..., 0])
        sb, cb = np.sin(q[..., 1]), np.cos(q[..., 1])
        out = np.empty_like(rates)
        out[..., 0] = rates[..., 0] + sb * rates[..., 2]
        out[..., 1] = ca * rates[..., 1] - sa * cb * rates[..., 2]
        out[..., 2] = sa * rates[..., 1] + ca * cb * rates[..., 2]
        return np.asarray((self._axes.astype(q.dtype) @ out[..., None])[..., 0])


def qpos_from_motion(human: Humanoid, root_pos_w_m: Array, local: Array, hinges_rad: Array) -> Array:
    """(T, 7+H) qpos from root positions (T, 3), local rotations (T, J, 3, 3) and hinge angles (T, H)."""
    quat = quat_from_matrix(local[:, 0])
    turned = np.sum(quat[1:] * quat[:-1], axis=-1) < 0  # the same rotation, on the other side of the sphere
    quat[1:] *= np.cumprod(np.where(turned, -1.0, 1.0))[:, None]
    return np.concatenate([root_pos_w_m, quat, hinges_rad], axis=-1)


def qvel_from_qpos(qpos: Array, rate_hz: float) -> Array:
    """(T, 6+H) velocities of qpos (T, 7+H) by central differences (one-sided at the ends), T >= 2."""
    ahead = np.concatenate([qpos[1:], qpos[-1:]])
    behind = np.concatenate([qpos[:1], qpos[:-1]])
    span = np.full((len(qpos), 1), 2.0 / rate_hz)
    span[0] = span[-1] = 1.0 / rate_hz
    rot_behind, rot_ahead = matrix_from_quat(behind[:, 3:7]), matrix_from_quat(ahead[:, 3:7])
    rot = matrix_from_quat(qpos[:, 3:7])
    step = rotvec_small(rot_behind.swapaxes(-1, -2) @ rot_ahead)  # in the frame of `behind`, axis kept by the rotation
    spin_w = (rot_behind @ step[..., None])[..., 0] / span
    spin_b = (rot.swapaxes(-1, -2) @ spin_w[..., None])[..., 0]
    return np.concatenate(
        [(ahead[:, :3] - behind[:, :3]) / span, spin_b, (ahead[:, 7:] - behind[:, 7:]) / span], axis=-1
    )


def rotvec_small(m: Array) -> Array:
    """Rotation vectors (..., 3) of matrices (..., 3, 3) that turn by less than pi."""
    axis = (
        np.stack([m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]], axis=-1) / 2
    )
    sine = np.linalg.norm(axis, axis=-1, keepdims=True)
    cosine = (np.trace(m, axis1=-2, axis2=-1)[..., None] - 1) / 2
    angle = np.arctan2(sine, cosine)
    return np.asarray(axis * np.where(sine > 1e-7, angle / np.maximum(sine, 1e-7), 1.0))
