"""Recorded motion as numpy arrays: what `motion.npz` holds."""

from __future__ import annotations

import io
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from orchestrator.client.models import index_of
from shared.errors import InvalidInputError
from shared.motion.clip import MotionClip

Array = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Motion:
    """Motion that was simulated, T control ticks at `fps` (30). World frame: Z up, metres, quaternions wxyz.

    Attributes:
        start_tick: tick of row 0; row i is at (start_tick + i) / fps seconds.
        skeleton, joints: id and joint names, in the order of the arrays.
        positions_w_m: (T, 22, 3). quats_w: (T, 22, 4), identity in the T-pose facing +X.
        velocities_w_mps: (T, 22, 3).
        reference_w_m: (T, 22, 3) the plan at the same times.
        contacts: (T, 4) bool: left heel, left toe, right heel, right toe.
        tracking_error_m: (T,). fallen: (T,) bool.
        objects: names; object_poses_w: (T, O, 7) position and quaternion.
    """

    fps: float
    start_tick: int
    skeleton: str
    joints: tuple[str, ...]
    positions_w_m: Array
    quats_w: Array
    velocities_w_mps: Array
    reference_w_m: Array
    contacts: npt.NDArray[np.bool_]
    tracking_error_m: Array
    fallen: npt.NDArray[np.bool_]
    objects: tuple[str, ...]
    object_poses_w: Array

    @classmethod
    def from_npz(cls, source: bytes | str | Path) -> Motion:
        """From the bytes or the path of an exported .npz; never unpickles. Raises InvalidInputError for other files."""
        try:
            with np.load(io.BytesIO(source) if isinstance(source, bytes) else source, allow_pickle=False) as data:
                return cls(
                    fps=float(data["fps"]),
                    start_tick=int(data["start_tick"]),
                    skeleton=str(data["skeleton"]),
                    joints=tuple(str(name) for name in data["joints"]),
                    positions_w_m=data["body_pos_w_m"],
                    quats_w=data["body_quat_w"],
                    velocities_w_mps=data["body_linvel_w_mps"],
                    reference_w_m=data["reference_pos_w_m"],
                    contacts=data["contacts"].astype(bool),
                    tracking_error_m=data["tracking_error_m"],
                    fallen=data["fallen"].astype(bool),
                    objects=tuple(str(name) for name in data["objects"]),
                    object_poses_w=data["object_pose_w"],
                )
        except (ValueError, KeyError, OSError, zipfile.BadZipFile) as error:
            raise InvalidInputError(
                f"no recorded motion: {error}", field="source", allowed="an exported .npz"
            ) from error

    def __len__(self) -> int:
        return len(self.positions_w_m)

    @property
    def duration_s(self) -> float:
        """From the first row to the last."""
        return (len(self) - 1) / self.fps

    @property
    def times_s(self) -> npt.NDArray[np.float64]:
        """(T,) simulated time of each row."""
        return (self.start_tick + np.arange(len(self))) / self.fps

    def joint(self, name: str) -> Array:
        """(T, 3) path of a joint; raises InvalidInputError listing the names."""
        return self.positions_w_m[:, index_of(self.joints, name)]

    def clip(self) -> MotionClip:
        """As the clip that the motion tools take (features, metrics, BVH writer)."""
        return MotionClip.from_bodies(self.positions_w_m, self.quats_w, self.fps, self.skeleton)
