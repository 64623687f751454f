"""What the bodies of a character touch, and the impulses that pass."""

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt

from tracker_service.simulation.scene import SceneModel

Array = npt.NDArray[np.float64]
FLOOR_COLUMN = 0
"""Column of the floor in arrays (J, 1 + O); object o has column 1 + o."""


class Contacts:
    """Reads MuJoCo's contacts as bodies J against the floor and O objects.

    Args:
        scene: whose contacts are read.
    """

    def __init__(self, scene: SceneModel):
        bodies = scene.model.nbody
        joint_of, column_of = np.full(bodies, -1), np.full(bodies, -1)
        joint_of[scene.body_ids] = np.arange(len(scene.body_ids))
        column_of[0] = FLOOR_COLUMN
        column_of[scene.object_ids] = 1 + np.arange(len(scene.object_ids))
        body_of = np.asarray(scene.model.geom_bodyid)
        self._joint_of, self._column_of = joint_of[body_of], column_of[body_of]
        self._timestep_s = float(scene.model.opt.timestep)
        self.shape = (len(scene.body_ids), 1 + len(scene.object_ids))

    def read(self, data: mujoco.MjData, forces: bool = True) -> tuple[npt.NDArray[np.bool_], Array]:
        """Which bodies touch what, and the normal impulses of the last physics step in N s; both (J, 1 + O).

        Args:
            forces: False: the contacts are those of a pose that is only shown, and no impulse passes.
        """
        touching, total_ns = np.zeros(self.shape, dtype=bool), np.zeros(self.shape)
        joints, columns, rows = self._pairs(data)
        if len(rows) == 0:
            return touching, total_ns
        touching[joints, columns] = True
        if not forces:
            return touching, total_ns
        contact = data.contact
        first, size = np.asarray(contact.efc_address)[rows], np.asarray(contact.dim)[rows]
        held = first >= 0
        # Friction cones are pyramids here: the normal force is the sum over the 2 (dim - 1) edges.
        count = np.where(size > 1, 2 * (size - 1), 1)
        summed = np.concatenate([[0.0], np.cumsum(data.efc_force)])
        force = np.where(held, summed[np.where(held, first + count, 0)] - summed[np.where(held, first, 0)], 0.0)
        place = joints * self.shape[1] + columns
        sums = np.bincount(place, np.maximum(force, 0.0) * self._timestep_s, minlength=total_ns.size)
        return touching, np.asarray(sums, dtype=np.float64).reshape(self.shape)

    def _pairs(self, data: mujoco.MjData) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], npt.NDArray[np.int64]]:
        """Joint, column and number of every contact between the character and something else."""
        geoms = np.asarray(data.contact.geom).reshape(-1, 2)
        joints, columns = self._joint_of[geoms], self._column_of[geoms]
        first = (joints[:, 0] >= 0) & (columns[:, 1] >= 0)
        second = (joints[:, 1] >= 0) & (columns[:, 0] >= 0)
        rows = np.flatnonzero(first | second)
        mine = np.where(first[rows], 0, 1)
        return joints[rows, mine], columns[rows, 1 - mine], rows
