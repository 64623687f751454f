"""The closed loop without physics: a planner's own output is its next prefix. Many bodies at once, one batch a plan.

Planner frames are at 20 fps, ticks at 30 Hz; frame k is at tick 1.5 k, so replanning every even number of frames keeps
plans at ticks divisible by 3.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from shared.errors import InvalidInputError
from shared.motion.resampling import finite_velocity, resample
from shared.plugins.interfaces import Planner
from shared.protocol.messages import PLANNER_FPS, TICK_HZ, PlanRequest
from shared.tasks.interface import BodyView, PlanGoal, Trace

Array = npt.NDArray[np.float64]
GoalOf = Callable[[int, BodyView], PlanGoal]
"""(body number, its present state) -> what to ask for."""


class Rollout:
    """Bodies moved by plans alone.

    Args:
        planner: makes the plans.
        start_w_m: (B, P, 22, 3) prefixes at 20 fps, P at least the planner's.
        seed: of the first plan of body 0; every body and plan has its own.
        replan_frames: even number of frames played of each plan.
        prefix_noise_m: standard deviation of the noise on every coordinate of the joints in what the planner is shown.
    """

    def __init__(
        self, planner: Planner, start_w_m: Array, seed: int, replan_frames: int = 20, prefix_noise_m: float = 0.0
    ):
        if replan_frames % 2 or not 2 <= replan_frames <= planner.spec.plan_frames:
            raise InvalidInputError(
                f"replan_frames is {replan_frames}", field="replan_frames", allowed="an even number within a plan"
            )
        self._planner, self._replan, self._seed = planner, replan_frames, seed
        self._noise_m, self._rng = prefix_noise_m, np.random.default_rng(seed)
        self._played = [row.copy() for row in np.asarray(start_w_m, dtype=np.float64)]
        self._plans = 0

    @property
    def tick(self) -> int:
        """Tick of the last frame played."""
        return self._plans * self._replan * 3 // 2

    def step(self, goal_of: GoalOf) -> None:
        """Plan once for all bodies and play `replan_frames` of it."""
        prefix = self._planner.spec.prefix_frames
        requests = []
        for body, frames in enumerate(self._played):
            view = BodyView(self.tick, frames[-1])
            goal = goal_of(body, view)
            window = frames[-prefix:]
            if self._noise_m:
                window = window + self._noise_m * self._rng.normal(size=window.shape)
            requests.append(
                PlanRequest(
                    start_tick=self.tick,
                    prefix_positions_w_m=window,
                    prefix_rotations_6d=np.zeros((prefix, 22, 6)),
                    prefix_velocities_w_mps=finite_velocity(window, PLANNER_FPS),
                    text=goal.text,
                    targets=list(goal.targets),
                    heading=goal.heading,
                    guidance=goal.guidance,
                    horizon_frames=self._planner.spec.plan_frames,
                    seed=self._seed + 1000 * body + self._plans,
                )
            )
        for body, plan in enumerate(self._planner.plan(requests)):
            new = plan.positions_w_m[: self._replan].astype(np.float64)
            self._played[body] = np.concatenate([self._played[body], new])
        self._plans += 1

    def frames(self, body: int, last: int | None = None) -> Array:
        """(T, 22, 3) what a body did at 20 fps, its starting prefix included; or only the last frames of it."""
        played: Array = self._played[body]
        return played if last is None else played[-last:]

    def trace(self, body: int, since_frame: int) -> Trace:
        """What a body did from a frame of `frames` on, at 30 Hz; nobody falls without physics."""
        pos = resample(self._played[body][since_frame:], PLANNER_FPS, TICK_HZ)
        return Trace(0, pos, np.zeros(len(pos), np.bool_))

    def lengths(self) -> Sequence[int]:
        """Frames played by each body."""
        return [len(p) for p in self._played]
