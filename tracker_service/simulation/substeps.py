"""What is read off the physics after each substep of a tick, raw: it is worked out for all of them at once."""

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Ids = npt.NDArray[np.integer]


class Substeps:
    """Arrays with a row a substep (S), of N frames, H hinges, J bodies and O objects.

    Args:
        count: S. frames: (N,) body ids in the model. roots: (N,) ids of the roots of their trees.
        hinges: H. contacts: (J, 1 + O).

    Attributes:
        pos_w_m (S, N, 3), quat_w (S, N, 4), com_velocity (S, N, 6), root_com_w_m (S, N, 3): as MuJoCo has them.
        hinge_pos_rad, hinge_vel_radps, servo_target_rad: (S, H).
        touching, impulse_ns: (S, J, 1 + O). fallen: (S,) uint8.
    """

    def __init__(self, count: int, frames: Ids, roots: Ids, hinges: int, contacts: tuple[int, int]):
        self._ids, self._roots = frames, roots
        self.pos_w_m, self.quat_w = np.empty((count, len(frames), 3)), np.empty((count, len(frames), 4))
        self.com_velocity, self.root_com_w_m = np.empty((count, len(frames), 6)), np.empty((count, len(frames), 3))
        self.hinge_pos_rad, self.hinge_vel_radps = np.empty((count, hinges)), np.empty((count, hinges))
        self.servo_target_rad = np.empty((count, hinges))
        self.touching, self.impulse_ns = np.empty((count, *contacts), np.bool_), np.empty((count, *contacts))
        self.fallen = np.empty(count, np.uint8)

    def keep(
        self, row: int, data: mujoco.MjData, touching: npt.NDArray[np.bool_], impulse_ns: Array, fallen: bool
    ) -> None:
        """Fill a row; the frames in `data` are those of its positions."""
        hinges = self.hinge_pos_rad.shape[1]
        self.pos_w_m[row], self.quat_w[row] = data.xpos[self._ids], data.xquat[self._ids]
        self.com_velocity[row], self.root_com_w_m[row] = data.cvel[self._ids], data.subtree_com[self._roots]
        self.hinge_pos_rad[row], self.hinge_vel_radps[row] = data.qpos[7 : 7 + hinges], data.qvel[6 : 6 + hinges]
        self.servo_target_rad[row] = data.ctrl
        self.touching[row], self.impulse_ns[row], self.fallen[row] = touching, impulse_ns, fallen
