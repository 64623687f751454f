"""Making tasks from their specs."""

from __future__ import annotations

from shared.tasks.builtin import HaltTask, ReachTask, TextTask
from shared.tasks.interface import Task
from shared.tasks.specs import HaltSpec, ReachSpec, TextSpec

BUILT_IN = ("reach", "halt", "text")


def make_task(spec: ReachSpec | HaltSpec | TextSpec, seed: int) -> Task:
    """The task that a spec describes; `seed` feeds its randomisation."""
    if isinstance(spec, ReachSpec):
        return ReachTask(spec, seed)
    if isinstance(spec, HaltSpec):
        return HaltTask(spec)
    return TextTask(spec)
