"""The planner `rise`: from however the body lies to standing.

It enters one of its get-ups at the pose nearest to the last prefix frame (`shared.motion.rise`). A body that does not
lie is brought to a stand as the planner `stand` does it. Conditions are not for somebody who gets up: it has none.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from planner_service.builtin.stand import coming_to_rest, plan_of
from shared.errors import InvalidInputError
from shared.motion.resampling import resample
from shared.motion.rise import LOW_PELVIS_M, Rises
from shared.motion.skeleton import CANONICAL
from shared.plugins.interfaces import PlannerSpec
from shared.protocol.messages import PLANNER_FPS, Plan, PlanRequest

Array = npt.NDArray[np.float64]

PLAN_FRAMES = 200
REPLAN_FRAMES = 140
"""7 s: a way up is played to its end; who still lies then is planned for anew."""


class RisePlanner:
    """See the module's docstring.

    Args:
        rises: get-ups at PLANNER_FPS.
    """

    def __init__(self, rises: Rises):
        self._rises = rises
        self.spec = PlannerSpec(
            name="rise", version="1", skeleton=CANONICAL.id, fps=PLANNER_FPS, prefix_frames=1, plan_frames=PLAN_FRAMES,
            replan_frames=REPLAN_FRAMES,
        )  # fmt: skip

    @classmethod
    def load(cls, folder: Path) -> RisePlanner:
        """With all `*.npz` (positions_w_m (T, 22, 3), fps) of a folder.

        Raises:
            InvalidInputError: there is no get-up.
        """
        motions = []
        for path in sorted(folder.glob("*.npz")):
            with np.load(path, allow_pickle=False) as data:
                motions.append(resample(data["positions_w_m"].astype(np.float64), float(data["fps"]), PLANNER_FPS))
        if not motions:
            raise InvalidInputError(f"no get-ups in {folder}", field="rise_library", allowed="*.npz")
        return cls(Rises(motions, PLANNER_FPS, CANONICAL))

    def plan(self, requests: list[PlanRequest]) -> list[Plan]:
        """One plan for each request; the seed changes nothing."""
        return [self._plan(request) for request in requests]

    def _plan(self, request: PlanRequest) -> Plan:
        last = np.asarray(request.prefix_positions_w_m[-1], dtype=np.float64)
        if last[0, 2] < LOW_PELVIS_M:
            way = self._rises.rise(last)[1:]
            count = request.horizon_frames
            positions = way[np.minimum(np.arange(count), len(way) - 1)]
        else:
            positions = coming_to_rest(request)
        return plan_of(self.spec.name, request, positions)
