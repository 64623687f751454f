"""When a character counts as fallen (DESIGN 2)."""

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt

from tracker_service.simulation.contacts import FLOOR_COLUMN
from tracker_service.simulation.humanoid import TRUNK
from tracker_service.simulation.scene import SceneModel
from tracker_service.simulation.surroundings import Heights

FALL_TICKS = 9
"""0.3 s at 30 Hz."""


class FallDetector:
    """Counts ticks on the floor: head below half its standing height over the floor, or pelvis, trunk or head on the
    floor; fallen after 0.3 s of that, and no longer as soon as it ends.

    The floor is the ground plane and whatever a scene calls ground; a seat is not. Where task or text ask for being low
    nothing counts; what the reference does excuses nothing.

    Attributes:
        down_ticks: consecutive ticks down.
    """

    def __init__(self, scene: SceneModel, heights: Heights):
        skeleton = scene.human.skeleton
        self._head_id = scene.body_ids[skeleton.index("head")]
        self._trunk = skeleton.indices(*TRUNK)
        self._low_head_m = 0.5 * float(skeleton.rest_positions_m[skeleton.index("head"), 2])
        ground = [1 + o for o, name in enumerate(scene.object_names) if scene.body_of(name).ground]
        self._floor = np.array([FLOOR_COLUMN, *ground])
        self._heights = heights
        self.down_ticks = 0

    @property
    def fallen(self) -> bool:
        """Down for 0.3 s or more."""
        return self.down_ticks >= FALL_TICKS

    def update(self, data: mujoco.MjData, touching: npt.NDArray[np.bool_], may_be_low: bool) -> None:
        """Count one tick. touching (J, 1 + O): what touches what."""
        head = data.xpos[self._head_id]
        low = head[2] - self._heights.ground_m(data, head) < self._low_head_m
        down = low or bool(touching[np.ix_(self._trunk, self._floor)].any())
        self.down_ticks = self.down_ticks + 1 if down and not may_be_low else 0
