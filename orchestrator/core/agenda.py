"""The tasks of an episode that are still to come: their order, and changes to it while the episode runs."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import Literal

import numpy as np

from orchestrator.core.keepsake import AgendaState
from orchestrator.core.loop import plan_seed
from shared.errors import ConflictError
from shared.tasks.factory import TaskSpec, make_task
from shared.tasks.interface import Task

MAX_TASKS = 500
SPARE_S = 120.0


def task_seed(seed: int, index: int) -> int:
    """Seed of a task's own randomisation."""
    return int.from_bytes(hashlib.sha256(f"{seed}/task/{index}".encode()).digest()[:8], "little") >> 1


class Agenda:
    """What is to be done, in order.

    Args:
        tasks: as given; a task keeps its index whatever the order is.
        order: `random` shuffles them by the seed.
        seed: of the episode.

    Attributes:
        longest_s: simulated time for all: theirs, and room for settling, a reset and an outage of the planner after
            each.
    """

    def __init__(self, tasks: Sequence[TaskSpec], order: Literal["sequence", "random"], seed: int):
        self.tasks: list[TaskSpec] = list(tasks)
        self.longest_s = SPARE_S + sum(_longest_s(task) for task in self.tasks)
        self._seed = seed
        self._to_come = list(range(len(self.tasks)))
        self._attempts: dict[int, int] = {}
        self._followed_by: dict[int, int | None] = {}
        if order == "random":
            np.random.default_rng(plan_seed(seed, -1)).shuffle(self._to_come)

    def __len__(self) -> int:
        """How many are still to come."""
        return len(self._to_come)

    def take(self) -> tuple[int, Task]:
        """The next one: its index and the task, ready to be started."""
        index = self._to_come.pop(0)
        return index, self.make(index)

    def again(self, index: int) -> bool:
        """Whether a task that has failed is tried once more: it is the next one then."""
        self._attempts[index] = self._attempts.get(index, 1) + 1
        if self._attempts[index] > 1 + self.tasks[index].retries:
            return False
        self._to_come.insert(0, index)
        return True

    def insert(self, task: TaskSpec, place: int) -> int:
        """Add one before what is `place`-th to come (0: next, beyond the end: last); returns its index.

        Raises ConflictError when there are too many.
        """
        if len(self.tasks) >= MAX_TASKS:
            raise ConflictError(f"it has {len(self.tasks)} tasks already", field="task", allowed=f"{MAX_TASKS}")
        index = self._add(task, place)
        following = self._to_come.index(index) + 1
        self._followed_by[index] = self._to_come[following] if following < len(self._to_come) else None
        return index

    def _add(self, task: TaskSpec, place: int) -> int:
        self.tasks.append(task)
        self.longest_s += _longest_s(task)
        self._to_come.insert(place, len(self.tasks) - 1)
        return len(self.tasks) - 1

    def remembered(self) -> AgendaState:
        """For `remember`."""
        return AgendaState(tasks=list(self.tasks), to_come=list(self._to_come), attempts=dict(self._attempts))

    def remember(self, state: AgendaState) -> None:
        """Go on as it was."""
        self.tasks, self._to_come = list(state.tasks), list(state.to_come)
        self._attempts = dict(state.attempts)
        self.longest_s = SPARE_S + sum(_longest_s(task) for task in self.tasks)

    def put_back(self, state: AgendaState) -> None:
        """As it was when it told `state`; but what was added since stays added, before the same tasks."""
        added = self.tasks[len(state.tasks) :]
        self.remember(state)
        for task in added:
            following = self._followed_by[len(self.tasks)]
            if following is None:
                self._add(task, len(self._to_come))
            else:
                # What it was to come before may be the task that is performed once more: it comes next, then.
                self._add(task, self._to_come.index(following) if following in self._to_come else 0)

    def make(self, index: int) -> Task:
        """A task of the agenda, ready to be started; one that has failed as it is tried again."""
        spec = self.tasks[index]
        return make_task(spec.again() if index in self._attempts else spec, task_seed(self._seed, index))


def _longest_s(task: TaskSpec) -> float:
    first, again = (make_task(each, 0).time_limit_s + 10.0 for each in (task, task.again()))
    return first + task.retries * again
