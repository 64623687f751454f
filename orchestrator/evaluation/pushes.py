"""Pushes in the middle of tasks: what happens is then not what was planned, which is what a closed loop is for."""

from __future__ import annotations

import numpy as np

from orchestrator.core.drivers import Cycle
from orchestrator.core.episode import EpisodeRunner
from shared.protocol.control import Ok
from shared.protocol.messages import TICK_HZ, Impulse

BODY = "pelvis"
AFTER_S = (0.5, 2.5)


class Pushes:
    """One push of the pelvis in each task, from any side, some time after it has begun.

    Args:
        runner: of the episode; the pushes are its `on_cycle`.
        seed: of the episode; sides and times are the same for every variant.
        impulse_ns: how hard, N s.
    """

    def __init__(self, runner: EpisodeRunner, seed: int, impulse_ns: float):
        self._runner, self._seed, self._impulse_ns = runner, seed, impulse_ns
        self._task, self._due_tick = -1, 0

    async def __call__(self, cycle: Cycle) -> None:
        """Push where it is time."""
        tick, task = cycle.state.tick, len(self._runner.results)
        rng = np.random.default_rng([self._seed, task])
        after_s, side = rng.uniform(*AFTER_S), rng.uniform(-np.pi, np.pi)
        if task != self._task:
            self._task, self._due_tick = task, tick + round(after_s * TICK_HZ)
        if self._due_tick == 0 or tick < self._due_tick:
            return
        self._due_tick = 0
        impulse = (float(self._impulse_ns * np.cos(side)), float(self._impulse_ns * np.sin(side)), 0.0)
        await self._runner.session.loop.ask_tracker(Ok, Impulse(body=BODY, impulse_w_ns=impulse))
