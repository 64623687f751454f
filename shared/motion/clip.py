"""MotionClip: motion that never travels without its rate and skeleton."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from shared.errors import InvalidInputError
from shared.motion.kinematics import local_from_global
from shared.motion.rotations import matrix_from_6d, matrix_from_quat, matrix_to_6d, quat_from_matrix
from shared.motion.skeleton import CANONICAL, Skeleton, skeleton


@dataclass(frozen=True)
class MotionClip:
    """A piece of motion. World Z up, metres.

    Attributes:
        positions_w_m: (T, J, 3) joint positions; joint 0 is the root.
        rotations_6d: (T, J, 6) rotation of each joint relative to its parent (the root's relative to the
            world), identity in the T-pose that faces +X.
        fps: frames per second; frame i is at time i / fps.
        skeleton_id: see `shared.motion.skeleton`.
    """

    positions_w_m: npt.NDArray[np.float64]
    rotations_6d: npt.NDArray[np.float64]
    fps: float
    skeleton_id: str = CANONICAL.id

    def __post_init__(self) -> None:
        joints = len(skeleton(self.skeleton_id))
        p, r = self.positions_w_m, self.rotations_6d
        if p.ndim != 3 or p.shape[1:] != (joints, 3):
            raise InvalidInputError(
                f"positions have shape {p.shape}", field="positions_w_m", allowed=f"(T, {joints}, 3)"
            )
        if r.shape != (p.shape[0], joints, 6):
            raise InvalidInputError(
                f"rotations have shape {r.shape}", field="rotations_6d", allowed=f"({p.shape[0]}, {joints}, 6)"
            )
        if not self.fps > 0:
            raise InvalidInputError(f"fps is {self.fps}", field="fps", allowed="> 0")
        if not (np.isfinite(p).all() and np.isfinite(r).all()):
            raise InvalidInputError("the clip has non-finite values", field="positions_w_m", allowed="finite")

    @classmethod
    def from_bodies(
        cls, positions_w_m: npt.ArrayLike, quats_w: npt.ArrayLike, fps: float, skeleton_id: str = CANONICAL.id
    ) -> MotionClip:
        """From world positions (T, J, 3) and world orientations (T, J, 4) wxyz of the bodies."""
        local = local_from_global(skeleton(skeleton_id), matrix_from_quat(quats_w))
        return cls(np.asarray(positions_w_m, dtype=np.float64), matrix_to_6d(local), fps, skeleton_id)

    def __len__(self) -> int:
        return int(self.positions_w_m.shape[0])

    @property
    def skeleton(self) -> Skeleton:
        """The skeleton the arrays belong to."""
        return skeleton(self.skeleton_id)

    @property
    def duration_s(self) -> float:
        """Time from the first frame to the last."""
        return (len(self) - 1) / self.fps

    @property
    def root_pos_w_m(self) -> npt.NDArray[np.float64]:
        """(T, 3)."""
        return self.positions_w_m[:, 0]

    @property
    def root_quat_w(self) -> npt.NDArray[np.float64]:
        """(T, 4) wxyz."""
        return quat_from_matrix(matrix_from_6d(self.rotations_6d[:, 0]))

    def slice(self, start: int, stop: int) -> MotionClip:
        """Frames start..stop-1 as a clip."""
        return replace(self, positions_w_m=self.positions_w_m[start:stop], rotations_6d=self.rotations_6d[start:stop])
