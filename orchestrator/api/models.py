"""Bodies of requests and replies that are not core types."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from orchestrator.core.character import CharacterSession
from orchestrator.core.command import Command
from orchestrator.core.episode_spec import EpisodeOutcome, EpisodeSpec
from orchestrator.core.scenes import name_of
from orchestrator.rest import CharacterFields, CommandReading, EpisodeFields, StateFields
from shared.motion.heading import hips_heading
from shared.motion.skeleton import CANONICAL
from shared.protocol.base import Name
from shared.protocol.messages import StateFrame
from shared.tasks.factory import TaskSpec

MAX_IMPULSE_NS = 500.0
Newtonseconds = Annotated[FiniteFloat, Field(ge=-MAX_IMPULSE_NS, le=MAX_IMPULSE_NS)]


class StateBody(StateFields):
    """State of a character, world frame, metres; joints in the order of `joints`."""

    joints: tuple[str, ...] = CANONICAL.names

    @classmethod
    def of(cls, state: StateFrame) -> StateBody:
        """From a state frame."""
        positions = np.asarray(state.body_pos_w_m, dtype=np.float64)
        return cls(
            tick=state.tick,
            time_s=state.time_s,
            positions_m=positions.round(4).tolist(),
            rotations_wxyz=np.asarray(state.body_quat_w, dtype=np.float64).round(5).tolist(),
            pelvis_m=positions[0].round(4).tolist(),
            heading_rad=round(float(hips_heading(positions)), 4),
            contacts=[bool(c) for c in np.asarray(state.contacts)],
            tracking_error_m=round(state.tracking_error_m, 5),
            fallen=state.fallen,
            plan_end_tick=state.plan_end_tick,
            missed_ticks=state.missed_ticks,
            tracker=state.tracker,
            failure=state.failure,
        )


class CharacterBody(CharacterFields):
    """A character: what it is, what it was told, and how it is."""

    command: Command
    state: StateBody

    @classmethod
    def of(cls, session: CharacterSession) -> CharacterBody:
        """From a session."""
        spec = session.spec
        return cls(
            id=session.character_id, status=session.status, reason=session.reason, scene=name_of(spec.scene),
            pacing=spec.pacing, planner=session.loop.planner, tracker=session.state.tracker, seed=spec.seed,
            command=session.command, plans=session.loop.plans_made, state=StateBody.of(session.state),
        )  # fmt: skip


class CharacterList(BaseModel):
    """All characters."""

    items: list[CharacterBody]


class CommandAccepted(CommandReading):
    """A command was taken at `tick`, and how."""

    tick: int
    command: Command


class ImpulseBody(BaseModel):
    """A push, in newton seconds, world frame."""

    model_config = ConfigDict(extra="forbid")
    body: str
    impulse_ns: tuple[Newtonseconds, Newtonseconds, Newtonseconds]


class StepBody(BaseModel):
    """How far a lockstep character should go."""

    model_config = ConfigDict(extra="forbid")
    ticks: Annotated[int, Field(ge=1, le=3000)] = 30


class EpisodeCreated(BaseModel):
    """An episode was started."""

    id: str
    status: Literal["running"] = "running"


class EpisodeBody(EpisodeFields):
    """An episode: what was asked, how far it is, how it went."""

    spec: EpisodeSpec
    outcome: EpisodeOutcome | None = None


class InsertBody(BaseModel):
    """A task to add, before what is `place`-th to come: 0 is next, and beyond the end is last."""

    model_config = ConfigDict(extra="forbid")
    task: TaskSpec
    place: Annotated[int, Field(ge=0, le=1000)] = 0


class TaskChanged(BaseModel):
    """What became of the task with this index."""

    index: int
    status: Literal["skipped", "inserted"]


class EpisodeList(BaseModel):
    """A page of episodes, newest first."""

    items: list[EpisodeBody]
    total: int
    limit: int
    offset: int


class SwapBody(BaseModel):
    """What to put in a slot: another service's endpoint, another plug-in, or both."""

    model_config = ConfigDict(extra="forbid")
    endpoint: Annotated[str, Field(max_length=300, pattern=r"^(tcp|ipc)://.+")] | None = None
    plugin: Name | None = None


class HealthBody(BaseModel):
    """How the orchestrator and its services are."""

    status: Literal["ok", "degraded"]
    services: dict[str, str] = {}
