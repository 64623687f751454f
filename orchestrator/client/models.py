"""What the server answers, as far as the client uses it; unknown fields are ignored."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict


class _Info(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore")


class StateInfo(_Info):
    """State of a character: world frame, metres, joints in the order of `joints`."""

    tick: int
    time_s: float
    joints: tuple[str, ...]
    positions_m: list[list[float]]
    pelvis_m: list[float]
    heading_rad: float
    tracking_error_m: float
    fallen: bool
    missed_ticks: int
    plan_end_tick: int


class CharacterInfo(_Info):
    """A commanded character."""

    id: str
    status: str
    reason: str | None = None
    pacing: str
    plans: int
    state: StateInfo


class TaskInfo(_Info):
    """How a task of an episode went."""

    index: int
    name: str
    type: str
    label: str
    success_strict: bool
    success_paper: bool
    success_code: bool
    fell: bool
    seconds: float
    start_tick: int
    stop_tick: int
    reason: str | None = None
    measures: dict[str, float] = {}


class EpisodeInfo(_Info):
    """An episode, running or over."""

    id: str
    status: str
    reason: str | None = None
    success: bool | None = None
    phase: str | None = None
    tick: int | None = None
    results: list[TaskInfo] = []
    services: dict[str, Any] = {}


class EventInfo(_Info):
    """Something that happened."""

    seq: int
    type: str
    tick: int
    data: dict[str, Any] = {}
