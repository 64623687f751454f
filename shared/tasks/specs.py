"""Tasks as data: what episode files and `POST /v1/episodes` hold."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, model_validator

from shared.protocol.messages import MAX_TEXT_CHARS

MAX_TARGET_DISTANCE_M = 30.0

Coordinate = Annotated[FiniteFloat, Field(ge=-1000.0, le=1000.0)]
Text = Annotated[str, Field(min_length=1, max_length=MAX_TEXT_CHARS)]
TimeLimit = Annotated[FiniteFloat, Field(gt=0, le=600)]
Guidance = Annotated[FiniteFloat, Field(ge=0, le=20)]


class Spec(BaseModel):
    """Base: immutable, no unknown fields."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class ReachTuning(Spec):
    """How a reach is cut into plans.

    Attributes:
        step_m: the target handed to the planner is at most this far ahead (REFERENCE 3: 1.2 m).
        speed_mps: natural speed that sets the arrival ticks.
        least_arrival_s: a target is never asked for sooner than this.
        near_m, stopping_s, leave_m, stop_m: within `near_m` of the goal the text becomes standing; if the body is
            farther than `leave_m` after `stopping_s`, it walks again, this time to within `stop_m`.
        heading_from_m: farther than this the body is asked to face the goal.
        turn_from_rad, turn_to_rad: a goal at a larger bearing is first turned to on the spot, until the bearing is
            smaller than the second; a walk that only curves would circle round a near goal.
    """

    step_m: Annotated[FiniteFloat, Field(gt=0, le=5)] = 1.2
    speed_mps: Annotated[FiniteFloat, Field(gt=0, le=5)] = 1.0
    least_arrival_s: Annotated[FiniteFloat, Field(ge=0.4, le=2)] = 0.6
    near_m: Annotated[FiniteFloat, Field(ge=0, le=2)] = 0.35
    stopping_s: Annotated[FiniteFloat, Field(ge=0, le=5)] = 1.0
    leave_m: Annotated[FiniteFloat, Field(ge=0, le=2)] = 0.3
    stop_m: Annotated[FiniteFloat, Field(ge=0, le=2)] = 0.25
    heading_from_m: Annotated[FiniteFloat, Field(ge=0, le=5)] = 0.5
    turn_from_rad: Annotated[FiniteFloat, Field(ge=0, le=7)] = 1.2
    turn_to_rad: Annotated[FiniteFloat, Field(ge=0, le=7)] = 0.6


class ReachSpec(Spec):
    """Go to a point: `position_m` in the world, or `relative_m` (ahead, left), or random when neither is given."""

    type: Literal["reach"] = "reach"
    name: Annotated[str, Field(max_length=80)] | None = None
    position_m: tuple[Coordinate, Coordinate] | None = None
    relative_m: tuple[Coordinate, Coordinate] | None = None
    random_distance_m: tuple[Annotated[FiniteFloat, Field(gt=0)], Annotated[FiniteFloat, Field(le=30)]] = (1.0, 3.0)
    text: Text = "a person is walking."
    time_limit_s: TimeLimit = 15.0
    guidance: Guidance | None = None
    tuning: ReachTuning = ReachTuning()

    @model_validator(mode="after")
    def _one_goal(self) -> ReachSpec:
        if self.position_m is not None and self.relative_m is not None:
            raise ValueError("give position_m or relative_m, not both")
        if self.random_distance_m[0] > self.random_distance_m[1]:
            raise ValueError("random_distance_m must be (least, most)")
        if self.relative_m is not None and max(map(abs, self.relative_m)) > MAX_TARGET_DISTANCE_M:
            raise ValueError(f"relative_m must be within {MAX_TARGET_DISTANCE_M:g} m")
        return self


class HaltSpec(Spec):
    """Stop within `settle_s` and stand for `duration_s`."""

    type: Literal["halt"] = "halt"
    name: Annotated[str, Field(max_length=80)] | None = None
    text: Text = "a person is standing still."
    settle_s: Annotated[FiniteFloat, Field(ge=0, le=10)] = 1.5
    duration_s: Annotated[FiniteFloat, Field(gt=0, le=120)] = 3.0
    drift_m: Annotated[FiniteFloat, Field(gt=0, le=5)] = 0.2
    guidance: Guidance | None = None


class TextSpec(Spec):
    """Do what the text says for `duration_s`."""

    type: Literal["text"] = "text"
    name: Annotated[str, Field(max_length=80)] | None = None
    text: Text
    duration_s: Annotated[FiniteFloat, Field(gt=0, le=120)] = 5.0
    guidance: Guidance | None = None


TaskSpec = Annotated[ReachSpec | HaltSpec | TextSpec, Field(discriminator="type")]
"""Any built-in task, told apart by `type`."""
