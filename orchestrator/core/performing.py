"""The task that an episode is at: what was asked of it, what was seen since it began."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pydantic import BaseModel, ConfigDict

from shared.motion.characters import build
from shared.scenes.schema import Scene
from shared.tasks.growing import GrowingTrace
from shared.tasks.interface import BodyView, PlanGoal, Task, Trace
from shared.tasks.rules import leaning, with_falls


class PerformingState(BaseModel):
    """Enough to make it again: a task does the same when it is asked the same.

    Attributes:
        goals: the tick of the body and of the plan, each time a goal was asked for.
    """

    model_config = ConfigDict(frozen=True)
    index: int
    begin_tick: int
    goals: list[tuple[int, int]]


class Performing:
    """The task being performed.

    Args:
        index: in the episode.
        task: started.
        begin_tick: when it began.
    """

    def __init__(self, index: int, task: Task, begin_tick: int):
        self.index = index
        self.task = task
        self.begin_tick = begin_tick
        self.seen = GrowingTrace(begin_tick + 1)
        self._goals: list[tuple[int, int]] = []

    @classmethod
    def again(cls, state: PerformingState, task: Task, trace: Trace, character: str, scene: Scene | None) -> Performing:
        """As it was when `state` was told.

        Args:
            task: not yet started.
            trace: of the character, from the tick at which the task began.
            character: of the registry.
            scene: as its seed made it.
        """
        task.start(replace(_view(trace, state.begin_tick, character), scene=scene))
        performing = cls(state.index, task, state.begin_tick)
        for view_tick, plan_tick in state.goals:
            performing.goal(_view(trace, view_tick, character), plan_tick)
        performing.seen.add(trace)
        return performing

    def state(self) -> PerformingState:
        """For `again`."""
        return PerformingState(index=self.index, begin_tick=self.begin_tick, goals=list(self._goals))

    def goal(self, view: BodyView, plan_tick: int) -> PlanGoal:
        """What the task asks for."""
        self._goals.append((view.tick, plan_tick))
        return self.task.goal(view, plan_tick)

    def add(self, trace: Trace) -> None:
        """What has happened since."""
        self.seen.add(trace)

    def forget_after(self, tick: int) -> None:
        """The character was put back to `tick`."""
        known = self.seen.trace().until(tick)
        self.seen = GrowingTrace(self.begin_tick + 1)
        self.seen.add(known)
        self._goals = [(view, plan) for view, plan in self._goals if view <= tick]

    def trace(self) -> Trace:
        """Everything since the task began; a body on the floor has fallen, unless the task may want it there."""
        trace = self.seen.trace()
        return with_falls(trace) if self.task.upright else trace

    @property
    def leaning(self) -> bool:
        """Whether it cannot be said yet that the body stayed up."""
        return (
            self.task.posture == "upright"
            and self.task.upright
            and len(self.seen) > 0
            and leaning(self.seen.trace().pos_w_m[-1])
        )


def _view(trace: Trace, tick: int, character: str) -> BodyView:
    """The body at a tick of a trace, as the tracker's state would have shown it."""
    body, row = build(character), tick - trace.start_tick
    world = trace.world
    names = () if world is None else world.objects
    poses = np.zeros((0, 7)) if world is None else world.pose_w[row]
    objects = dict(zip(names, poses, strict=True))
    return BodyView(tick, trace.pos_w_m[row], bool(trace.fallen[row]), body.world_scale, objects, body.mass_kg)
