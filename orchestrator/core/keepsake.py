"""What is kept of a character at each plan, so that it can go on from there when its tracker is lost."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict

from orchestrator.core.machine import Phase
from orchestrator.core.performing import PerformingState
from orchestrator.rest import TaskResult
from shared.protocol.messages import LOG_HZ, TICK_HZ, Snapshot
from shared.tasks.factory import TaskSpec

SAMPLES_A_TICK = LOG_HZ // TICK_HZ


class Pace(BaseModel):
    """Where a driver is: when it plans next, the plan in force, and plans that came early or were bad.

    Attributes:
        entered: start tick and period of the plan in force; None where there is none.
    """

    model_config = ConfigDict(frozen=True)
    next_plan_tick: int
    entered: tuple[int, int] | None = None
    early: tuple[int, ...] = ()
    bad_plans: int = 0


class LoopState(BaseModel):
    """What a loop knows beside the motion it has planned.

    Attributes:
        endpoint: of the tracker at which the character lives.
    """

    model_config = ConfigDict(frozen=True)
    endpoint: str
    planner: str | None = None
    plans_made: int = 0
    since_tick: int = 0
    may_be_low: tuple[int, bool] = (-1, False)
    has_plan: bool = False
    fps: int
    first_frame: int = 0


class MachineView(BaseModel):
    """A state of the machine (`core.machine.MachineState`)."""

    model_config = ConfigDict(frozen=True)
    phase: Phase
    entered_tick: int
    timeout_ticks: int | None
    retries_used: int


class AgendaState(BaseModel):
    """The tasks and those of them that are still to come."""

    model_config = ConfigDict(frozen=True)
    tasks: list[TaskSpec]
    to_come: list[int]
    attempts: dict[int, int]


class EpisodeState(BaseModel):
    """Where an episode is, beside its character."""

    model_config = ConfigDict(frozen=True)
    machine: MachineView
    agenda: AgendaState
    results: list[TaskResult]
    performing: PerformingState | None
    down: bool
    missed_ticks: int
    last_report: int
    reason: str | None = None


@dataclass(frozen=True)
class Keepsake:
    """A character at a tick.

    Attributes:
        snapshot: the tracker's.
        loop, pace: the orchestrator's own part.
        planned_w_m: (T, J, 3) what is planned, from `loop.first_frame` on.
    """

    snapshot: Snapshot
    loop: LoopState
    pace: Pace
    planned_w_m: npt.NDArray[np.float64]

    @property
    def tick(self) -> int:
        """When it was."""
        return self.snapshot.tick

    @property
    def first_logged_tick(self) -> int:
        """From when on a tracker that restores the snapshot has the log."""
        return -(-int(str(self.snapshot.meta["first_sample"])) // SAMPLES_A_TICK)
