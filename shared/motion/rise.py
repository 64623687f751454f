"""From lying to standing: a way of getting up, entered at the pose that is nearest to how the body lies.

A body that has fallen lies in some pose of its own. The nearest low pose of a set of get-ups is looked for, in whatever
place and direction; the body's pose is blended into it, and the get-up goes on from there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.errors import InvalidInputError
from shared.motion.ik import rotations_from_positions
from shared.motion.kinematics import forward_kinematics
from shared.motion.rotations import matrix_from_rotvec, rotvec_from_matrix
from shared.motion.skeleton import Skeleton

Array = npt.NDArray[np.float64]

LOW_PELVIS_M = 0.5
"""A get-up is entered at poses whose pelvis is lower than this."""
SHORTEST_BLEND_S, LONGEST_BLEND_S, BLEND_S_PER_M = 0.5, 1.6, 3.0
STRIDE = 3
"""Every third frame of a get-up is looked at."""
LEAST_HEIGHT_M = 0.03
WAY_COST_M_PER_S = 0.01
"""What a second of getting up counts against a nearer pose."""


@dataclass(frozen=True)
class Entry:
    """Where a get-up is entered: its number, its frame, and the mean joint distance there."""

    number: int
    frame: int
    distance_m: float


def lies_toward(pose_w_m: Array, skeleton: Skeleton) -> Array:
    """(..., 2) horizontal unit vector from the pelvis to the neck of poses (..., J, 3): a lying body's direction.

    A body whose trunk is upright has none of its own; the perpendicular of its hips is taken.
    """
    along = pose_w_m[..., skeleton.index("neck"), :2] - pose_w_m[..., 0, :2]
    hips = pose_w_m[..., skeleton.index("left_hip"), :2] - pose_w_m[..., skeleton.index("right_hip"), :2]
    ahead = np.stack([hips[..., 1], -hips[..., 0]], axis=-1)
    length = np.linalg.norm(along, axis=-1, keepdims=True)
    vector = np.where(length > 0.15, along, ahead)
    return np.asarray(vector / np.maximum(np.linalg.norm(vector, axis=-1, keepdims=True), 1e-9))


def _placed(poses_w_m: Array, skeleton: Skeleton) -> Array:
    """Poses (..., J, 3) turned to lie along X, their joints' mean over the origin."""
    c, s = np.moveaxis(lies_toward(poses_w_m, skeleton), -1, 0)[..., None]
    x, y = np.moveaxis(poses_w_m[..., :2] - poses_w_m[..., :2].mean(axis=-2, keepdims=True), -1, 0)
    return np.stack([c * x + s * y, c * y - s * x, poses_w_m[..., 2]], axis=-1)


class Rises:
    """A set of get-ups.

    Args:
        motions: (T, J, 3) each, at `fps`, from lying to standing. skeleton: theirs.

    Raises:
        InvalidInputError: none of them has a low pose.
    """

    def __init__(self, motions: Sequence[npt.ArrayLike], fps: float, skeleton: Skeleton):
        self._motions = [np.asarray(m, dtype=np.float64) for m in motions]
        self._fps, self._skeleton = fps, skeleton
        frames = [np.flatnonzero(m[:, 0, 2] < LOW_PELVIS_M)[::STRIDE] for m in self._motions]
        self._number = np.repeat(np.arange(len(frames)), [len(f) for f in frames])
        if not len(self._number):
            raise InvalidInputError(
                "no get-up with a low pose", field="rises", allowed=f"pelvis under {LOW_PELVIS_M} m"
            )
        self._frame = np.concatenate(frames)
        self._poses = _placed(np.concatenate([m[f] for m, f in zip(self._motions, frames, strict=True)]), skeleton)
        left = np.array([len(m) for m in self._motions])[self._number] - self._frame
        self._cost = WAY_COST_M_PER_S * left / fps

    def nearest(self, pose_w_m: npt.ArrayLike) -> Entry:
        """Where a body in a pose (J, 3) enters."""
        pose = _placed(np.asarray(pose_w_m, dtype=np.float64), self._skeleton)
        distance = np.linalg.norm(self._poses - pose, axis=-1).mean(axis=-1)
        best = int(np.argmin(distance + self._cost))
        return Entry(int(self._number[best]), int(self._frame[best]), float(distance[best]))

    def rise(self, pose_w_m: npt.ArrayLike) -> Array:
        """A way from a lying pose (J, 3) to standing, (T, J, 3) at the motions' rate; it begins with that pose."""
        pose = np.asarray(pose_w_m, dtype=np.float64)
        entry = self.nearest(pose)
        motion = self._brought(self._motions[entry.number], entry.frame, pose)
        seconds = float(np.clip(BLEND_S_PER_M * entry.distance_m, SHORTEST_BLEND_S, LONGEST_BLEND_S))
        s = np.arange(max(round(seconds * self._fps), 2)) / max(round(seconds * self._fps), 2)
        blended = between(pose, motion[entry.frame], s * s * (3.0 - 2.0 * s), self._skeleton)
        return np.concatenate([blended, motion[entry.frame :]])

    def _brought(self, motion: Array, frame: int, pose: Array) -> Array:
        """A motion turned and shifted so that at `frame` it lies where and as a pose does."""
        own, wanted = lies_toward(motion[frame], self._skeleton), lies_toward(pose, self._skeleton)
        c, s = own @ wanted, own[0] * wanted[1] - own[1] * wanted[0]
        turn = np.array([[c, -s], [s, c]])
        out = motion.copy()
        out[..., :2] = (motion[..., :2] - motion[frame, :, :2].mean(axis=0)) @ turn.T + pose[:, :2].mean(axis=0)
        return out


def between(start_w_m: Array, goal_w_m: Array, share: Array, skeleton: Skeleton) -> Array:
    """Poses (N, J, 3) between two poses (J, 3) by their joints' rotations, none of them under the floor.

    Args:
        share: (N,) of the way, 0 to 1.
    """
    local = rotations_from_positions(np.stack([start_w_m, goal_w_m]), skeleton)
    way = rotvec_from_matrix(local[0].swapaxes(-1, -2) @ local[1])
    rotations = local[0] @ matrix_from_rotvec(share[:, None, None] * way)
    root = start_w_m[0] + share[:, None] * (goal_w_m[0] - start_w_m[0])
    poses = np.asarray(forward_kinematics(skeleton, root, rotations)[0])
    # Rotations found from positions give them back but nearly: both ends are met exactly.
    ends = np.asarray(forward_kinematics(skeleton, np.stack([start_w_m[0], goal_w_m[0]]), local)[0])
    s = share[:, None, None]
    poses = poses + (1.0 - s) * (start_w_m - ends[0]) + s * (goal_w_m - ends[1])
    lowest = min(float(start_w_m[:, 2].min()), float(goal_w_m[:, 2].min()), LEAST_HEIGHT_M)
    poses[..., 2] += np.maximum(lowest - poses[..., 2].min(axis=-1), 0.0)[:, None]
    return poses
