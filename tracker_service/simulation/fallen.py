"""When a character counts as fallen (DESIGN 2), and which of its bodies touch something."""

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt

from tracker_service.simulation.humanoid import TRUNK
from tracker_service.simulation.scene import SceneModel

Array = npt.NDArray[np.float64]

FALL_TICKS = 9
"""0.3 s at 30 Hz."""
LYING_TRUNK_M = 0.17
"""A reference whose trunk or head comes this close to the floor means to lie or sit on it."""


def floor_touch(scene: SceneModel, data: mujoco.MjData, floor_only: bool = True) -> npt.NDArray[np.bool_]:
    """(J,) which bodies touch the floor (or anything), as of the last physics step."""
    model = scene.model
    touching = np.zeros(model.nbody, dtype=bool)
    pairs = np.asarray(data.contact.geom).reshape(-1, 2)
    bodies = model.geom_bodyid[pairs]
    if floor_only:
        bodies = bodies[(bodies == 0).any(axis=1)]
    touching[bodies.ravel()] = True
    return np.asarray(touching[scene.body_ids])


class FallDetector:
    """Counts ticks on the floor: head below half its standing height, or pelvis, trunk or head on the floor, while the
    reference does neither; fallen after 0.3 s of that, and no longer as soon as it ends.

    Attributes:
        down_ticks: consecutive ticks down.
    """

    def __init__(self, scene: SceneModel):
        skeleton = scene.human.skeleton
        self._head_id = scene.body_ids[skeleton.index("head")]
        self._head = skeleton.index("head")
        self._trunk = skeleton.indices(*TRUNK)
        self._low_head_m = 0.5 * float(skeleton.rest_positions_m[self._head, 2])
        self.down_ticks = 0

    @property
    def fallen(self) -> bool:
        """Down for 0.3 s or more."""
        return self.down_ticks >= FALL_TICKS

    def update(self, data: mujoco.MjData, touching: npt.NDArray[np.bool_], reference_pos_w_m: Array) -> None:
        """Count one tick. touching (J,) by the floor; reference_pos_w_m (J, 3) at this tick."""
        down = data.xpos[self._head_id, 2] < self._low_head_m or bool(touching[self._trunk].any())
        meant = reference_pos_w_m[self._head, 2] < self._low_head_m or bool(
            (reference_pos_w_m[self._trunk, 2] < LYING_TRUNK_M).any()
        )
        self.down_ticks = self.down_ticks + 1 if down and not meant else 0
