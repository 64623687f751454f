"""What an episode is asked to be, and what became of it."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from orchestrator.core.on_fall import OnFall
from orchestrator.core.scenes import SceneChoice
from orchestrator.core.settings import LoopSettings
from orchestrator.rest import TaskResult
from shared.protocol.base import Name
from shared.protocol.messages import Pacing, Seed
from shared.tasks.factory import TaskSpec
from shared.tasks.specs import TimeLimit


class EpisodeSpec(BaseModel):
    """What to do, with what, and how.

    Attributes:
        order: `random` shuffles the tasks by the seed.
        on_fall: after a fall the task has failed, and the character is put on its feet, gets up (and is put on its feet
            where it does not manage to), or stays down for the tasks that follow.
        loop: settings of the loop; None for the defaults of the pacing.
        time_limit_s: simulated seconds for all tasks together; None for the sum of theirs.
        heading_rad: which way the character faces at the start.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")
    name: Annotated[str, Field(max_length=80)] | None = None
    character: Name = "human"
    scene: SceneChoice = "flat"
    tasks: Annotated[list[TaskSpec], Field(min_length=1, max_length=200)]
    order: Literal["sequence", "random"] = "sequence"
    seed: Seed = 0
    pacing: Pacing = "lockstep"
    time_limit_s: TimeLimit | None = None
    planner: Name | None = None
    tracker: Name | None = None
    loop: LoopSettings | None = None
    on_fall: OnFall = "reset"
    heading_rad: Annotated[FiniteFloat, Field(ge=-100, le=100)] = 0.0


class EpisodeOutcome(BaseModel):
    """How the episode ended."""

    model_config = ConfigDict(frozen=True)
    status: Literal["finished", "failed", "cancelled"]
    reason: str | None
    success: bool
    results: list[TaskResult]
    ticks: int
    plans: int
    missed_ticks: int
