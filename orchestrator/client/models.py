"""What the client hands out: states, characters, episodes and plans, with numpy arrays where there are numbers."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from pydantic import Field, ValidationError

from orchestrator.rest import CharacterFields, CommandReading, EpisodeFields, Event, StateFields
from shared.errors import InvalidInputError, MalformedMessageError

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class State:
    """State of a character at a control tick. World frame: Z up, metres, radians, quaternions wxyz.

    Attributes:
        tick, time_s: 30 ticks a second.
        joints: names, in the order of the arrays.
        positions_w_m: (22, 3). quats_w: (22, 4), identity in the T-pose facing +X.
        heading_rad: where the hips face, 0 along +X, anticlockwise.
        contacts: (4,) bool: left heel, left toe, right heel, right toe.
        tracking_error_m: mean distance of the joints from the plan.
        plan_end_tick: where the present plan ends.
        missed_ticks: ticks that ran more than 33 ms late.
        failure: what went wrong with the physics, if anything.
    """

    tick: int
    time_s: float
    joints: tuple[str, ...]
    positions_w_m: Array
    quats_w: Array
    heading_rad: float
    contacts: npt.NDArray[np.bool_]
    tracking_error_m: float
    fallen: bool
    plan_end_tick: int
    missed_ticks: int
    tracker: str
    failure: str | None

    @classmethod
    def of(cls, fields: StateFields) -> State:
        """From the server's reply."""
        return cls(
            tick=fields.tick,
            time_s=fields.time_s,
            joints=fields.joints,
            positions_w_m=np.array(fields.positions_m, dtype=np.float64),
            quats_w=np.array(fields.rotations_wxyz, dtype=np.float64),
            heading_rad=fields.heading_rad,
            contacts=np.array(fields.contacts, dtype=bool),
            tracking_error_m=fields.tracking_error_m,
            fallen=fields.fallen,
            plan_end_tick=fields.plan_end_tick,
            missed_ticks=fields.missed_ticks,
            tracker=fields.tracker,
            failure=fields.failure,
        )

    @property
    def pelvis_w_m(self) -> Array:
        """(3,) position of the root."""
        return self.positions_w_m[0]

    def joint(self, name: str) -> Array:
        """(3,) position of a joint; raises InvalidInputError listing the names."""
        return self.positions_w_m[index_of(self.joints, name)]


@dataclass(frozen=True)
class PlanGhost:
    """A plan as the planner imagines it: positions_w_m (F, 22, 3) at `fps`, frame i at start_tick/30 + (i+1)/fps s."""

    start_tick: int
    fps: float
    positions_w_m: Array


class CharacterInfo(CharacterFields):
    """A character as it is now; `command` is the one in force, as `POST .../commands` takes it."""

    command: dict[str, Any] = Field(default_factory=dict)
    state: StateFields

    def now(self) -> State:
        """Its state with numpy arrays."""
        return State.of(self.state)


class CommandTaken(CommandReading):
    """A command that was taken at `tick`, and how it was understood."""

    tick: int


class EpisodeInfo(EpisodeFields):
    """An episode as it is now; `spec` is what was asked for, as `POST /v1/episodes` takes it."""

    spec: dict[str, Any] = Field(default_factory=dict)


def index_of(joints: tuple[str, ...], name: str) -> int:
    """Place of a joint; raises InvalidInputError listing the names."""
    if name not in joints:
        raise InvalidInputError(f"unknown joint {name!r}", field="joint", allowed=", ".join(joints))
    return joints.index(name)


def message_of(text: str | bytes) -> State | PlanGhost | Event:
    """One message of a character's WebSocket; raises MalformedMessageError."""
    try:
        message = json.loads(text)
        if message["type"] == "state":
            return State.of(StateFields.model_validate(message))
        if message["type"] == "event":
            return Event.model_validate(message["event"])
        positions = np.array(message["positions_m"], dtype=np.float64)
        return PlanGhost(int(message["start_tick"]), float(message["fps"]), positions)
    except (ValueError, KeyError, TypeError, ValidationError) as error:
        raise MalformedMessageError(f"the server sent something unknown: {str(text)[:80]}") from error


def event_of(line: str) -> Event | None:
    """The event in one line of a stream of server-sent events, if it holds one."""
    return Event.model_validate_json(line.removeprefix("data: ")) if line.startswith("data: ") else None
