"""The kinds of tasks there are, built in and of installed packages, and making tasks from their specs.

A package offers a task with

    [project.entry-points."motionloop.tasks"]
    touch = "my_package:KIND"               # a TaskKind; its spec's `type` is the name, here `touch`

An episode then takes `{"type": "touch", ...}` like any other, over HTTP, in files and in `eval tasks`.
"""

from __future__ import annotations

import functools
import logging
import operator
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import entry_points
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args, get_origin

from pydantic import Field

from shared.errors import InvalidInputError
from shared.plugins.registry import TASKS
from shared.tasks.builtin import HaltTask, ReachTask, TextTask
from shared.tasks.interface import Task
from shared.tasks.object_specs import GetUpSpec, SitSpec, StrikeSpec
from shared.tasks.seats import GetUpTask, SitTask
from shared.tasks.specs import BaseTaskSpec, HaltSpec, ReachSpec, TextSpec, VelocitySpec
from shared.tasks.strike import StrikeTask
from shared.tasks.velocity import VelocityTask

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class TaskKind:
    """A kind of task.

    Attributes:
        spec: its fields; `type` is a Literal with a default, the kind's name.
        make: the task of a spec, given a seed for its randomisation.
    """

    spec: type[BaseTaskSpec]
    make: Callable[[Any, int], Task]

    @property
    def name(self) -> str:
        """As in `type`."""
        return str(self.spec.model_fields["type"].default)


_BUILT_IN = (
    TaskKind(ReachSpec, ReachTask),
    TaskKind(StrikeSpec, lambda spec, seed: StrikeTask(spec)),
    TaskKind(SitSpec, lambda spec, seed: SitTask(spec)),
    TaskKind(GetUpSpec, lambda spec, seed: GetUpTask(spec)),
    TaskKind(HaltSpec, lambda spec, seed: HaltTask(spec)),
    TaskKind(TextSpec, lambda spec, seed: TextTask(spec)),
    TaskKind(VelocitySpec, lambda spec, seed: VelocityTask(spec)),
)


def _named(spec: type[BaseTaskSpec]) -> bool:
    """Whether its `type` is one literal, which is also the default: requests are told apart by it."""
    field = spec.model_fields.get("type")
    return (
        field is not None and get_origin(field.annotation) is Literal and get_args(field.annotation) == (field.default,)
    )


def _found() -> dict[str, TaskKind]:
    """Built-in kinds, then those of packages; one that does not load, or takes a name that is taken, is left out."""
    kinds = {kind.name: kind for kind in _BUILT_IN}
    for point in entry_points(group=TASKS):
        try:
            kind = point.load()
        except (ImportError, AttributeError) as error:
            log.warning("task %s is not offered: its package does not load: %s", point.name, error)
            continue
        if not isinstance(kind, TaskKind) or not _named(kind.spec):
            log.warning("task %s is not offered: %s is no TaskKind with a `type`", point.name, point.value)
        elif kind.name in kinds:
            log.warning("task %s is not offered: the name %s is taken", point.name, kind.name)
        else:
            kinds[kind.name] = kind
    return kinds


KINDS = _found()
"""All kinds by name."""
_BY_SPEC = {kind.spec: kind for kind in KINDS.values()}

if TYPE_CHECKING:
    TaskSpec = BaseTaskSpec
else:
    TaskSpec = Annotated[functools.reduce(operator.or_, _BY_SPEC), Field(discriminator="type")]
"""Any task, told apart by `type`."""


def make_task(spec: BaseTaskSpec, seed: int) -> Task:
    """The task that a spec describes; `seed` feeds its randomisation.

    Raises:
        InvalidInputError: no kind has specs of this class.
    """
    kind = _BY_SPEC.get(type(spec))
    if kind is None:
        raise InvalidInputError(f"{type(spec).__name__} is no task's", field="type", allowed=", ".join(KINDS))
    return kind.make(spec, seed)
