"""The task that an episode is at: what was asked of it, what was seen since it began."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pydantic import BaseModel, ConfigDict

from orchestrator.core.own_world import Planned, as_planned, trace_as_planned
from orchestrator.rest import TaskResult
from shared.motion.characters import build
from shared.protocol.messages import SetObject
from shared.scenes.schema import Scene
from shared.tasks.growing import GrowingTrace
from shared.tasks.interface import BodyView, PlanGoal, Status, Task, Trace, Verdict
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
        task: not yet started.
        begin: the body when it begins.
        planned: in an open loop: the task is told what is planned in place of what is seen, and that objects are where
            they were when it began. It is judged by what is seen all the same.
    """

    def __init__(self, index: int, task: Task, begin: BodyView, planned: Planned | None = None):
        self.index = index
        self.task = task
        self.begin_tick = begin.tick
        self.seen = GrowingTrace(begin.tick + 1)
        self._begin = begin
        self._planned = planned
        self._told = self.seen if planned is None else GrowingTrace(begin.tick + 1)
        self._goals: list[tuple[BodyView, int]] = []
        task.start(as_planned(begin, planned))

    @classmethod
    def again(
        cls, state: PerformingState, task: Task, trace: Trace, character: str, scene: Scene | None,
        planned: Planned | None = None,
    ) -> Performing:  # fmt: skip
        """As it was when `state` was told.

        Args:
            task: not yet started.
            trace: of the character, from the tick at which the task began.
            character: of the registry.
            scene: as its seed made it.
            planned: as for the class, with what was planned since the task began.
        """
        begin = replace(_view(trace, state.begin_tick, character), scene=scene)
        performing = cls(state.index, task, begin, planned)
        for view_tick, plan_tick in state.goals:
            performing.goal(_view(trace, view_tick, character), plan_tick)
        performing.add(trace)
        return performing

    def state(self) -> PerformingState:
        """For `again`."""
        goals = [(view.tick, plan_tick) for view, plan_tick in self._goals]
        return PerformingState(index=self.index, begin_tick=self.begin_tick, goals=goals)

    def goal(self, view: BodyView, plan_tick: int) -> PlanGoal:
        """What the task asks for."""
        self._goals.append((view, plan_tick))
        return self.task.goal(as_planned(view, self._planned, self._begin.objects), plan_tick)

    def add(self, trace: Trace) -> None:
        """What has happened since."""
        self.seen.add(trace)
        if self._planned is not None:
            new = trace.since(self.begin_tick + 1)
            self._told.add(trace_as_planned(new, self._planned, self._begin.objects))

    def status(self) -> Status:
        """Whether the task is over, by what it is told."""
        return self.task.status(self._with_falls(self._told))

    def put_back(self, state: PerformingState, task: Task, tick: int) -> Performing:
        """As it was when it told `state`: what it has been asked and has seen since has not happened.

        Args:
            task: the same, not yet started.
            tick: to which the character was put back.
        """
        performing = Performing(self.index, task, self._begin, self._planned)
        for view, plan_tick in self._goals[: len(state.goals)]:
            performing.goal(view, plan_tick)
        performing.add(self.seen.trace().until(tick))
        return performing

    def trace(self) -> Trace:
        """Everything since the task began; a body on the floor has fallen, unless the task may want it there."""
        return self._with_falls(self.seen)

    def _with_falls(self, seen: GrowingTrace) -> Trace:
        trace = seen.trace()
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

    def result(self, verdict: Verdict, name: str | None, stop_tick: int, reason: str | None) -> TaskResult:
        """How it went; `reason` says why it did not succeed. In an open loop it has one measure more, `off_plan_m`: the
        mean distance of the pelvis from where it was planned."""
        measures = dict(verdict.measures)
        if self._planned is not None and len(self.seen):
            off_m = (self.seen.trace().pos_w_m - self._told.trace().pos_w_m)[:, 0]
            measures["off_plan_m"] = float(np.linalg.norm(off_m, axis=-1).mean())
        return TaskResult(
            index=self.index,
            name=name or self.task.label,
            type=self.task.kind,
            label=self.task.label,
            success_strict=reason is None,
            success_paper=verdict.paper,
            success_code=verdict.code,
            fell=verdict.fell,
            seconds=round(verdict.seconds, 3),
            start_tick=self.begin_tick,
            stop_tick=stop_tick,
            reason=reason,
            measures={name: round(value, 4) for name, value in measures.items()},
        )


def props_of(task: Task, view: BodyView) -> list[SetObject]:
    """The objects that a task wants elsewhere before it begins, put there and at rest."""
    still = (0.0, 0.0, 0.0)
    out: list[SetObject] = []
    for name, pose in task.props(view).items():
        x, y, z, *quat = (float(v) for v in pose)
        move = SetObject(
            name=name, position_w_m=(x, y, z), quat_w=(quat[0], quat[1], quat[2], quat[3]),
            linvel_w_mps=still, angvel_w_radps=still,
        )  # fmt: skip
        out.append(move)
    return out


def _view(trace: Trace, tick: int, character: str) -> BodyView:
    """The body at a tick of a trace, as the tracker's state would have shown it."""
    body, row = build(character), tick - trace.start_tick
    world = trace.world
    names = () if world is None else world.objects
    poses = np.zeros((0, 7)) if world is None else world.pose_w[row]
    objects = dict(zip(names, poses, strict=True))
    return BodyView(tick, trace.pos_w_m[row], bool(trace.fallen[row]), body.world_scale, objects, body.mass_kg)
