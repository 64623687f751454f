"""Tasks as data: what episode files and `POST /v1/episodes` hold."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, model_validator

from shared.protocol.messages import MAX_TEXT_CHARS
from shared.scenes.schema import Scene
from shared.text.wording import STAND_TEXT

MAX_TARGET_DISTANCE_M = 30.0

Coordinate = Annotated[FiniteFloat, Field(ge=-1000.0, le=1000.0)]
Text = Annotated[str, Field(min_length=1, max_length=MAX_TEXT_CHARS)]
TimeLimit = Annotated[FiniteFloat, Field(gt=0, le=600)]
Speed = Annotated[FiniteFloat, Field(ge=-5, le=5)]
Guidance = Annotated[FiniteFloat, Field(ge=0, le=20)]


WALK_TEXT = "a person is walking."
Gait = Literal["walk", "run", "jog", "sneak", "march", "skip"]
Style = Literal["happily", "sadly", "angrily", "proudly", "tiredly", "carefully"]
GAITS: dict[Gait, tuple[str, float]] = {
    "walk": ("walking", 1.0),
    "run": ("running", 2.2),
    "jog": ("jogging", 1.7),
    "sneak": ("sneaking", 0.6),
    "march": ("marching", 1.1),
    "skip": ("skipping", 1.4),
}
"""The word for a gait and its natural speed, m/s."""


class Spec(BaseModel):
    """Base: immutable, no unknown fields."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class BaseTaskSpec(Spec):
    """What every task has; a task of one's own adds `type: Literal["its_name"]` and its fields.

    Attributes:
        name: for people.
        retries: how often an episode tries it again after a failure, a fall or a time-out.
    """

    name: Annotated[str, Field(max_length=80)] | None = None
    retries: Annotated[int, Field(ge=0, le=10)] = 0

    def check(self, scene: Scene | None) -> None:
        """Raise InvalidInputError where the scene lacks what the task is about; None: nobody knows the scene yet."""

    def again(self) -> BaseTaskSpec:
        """What is tried after it has failed; by default the same."""
        return self


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


class ReachSpec(BaseTaskSpec):
    """Go to a point: `position_m` in the world, or `relative_m` (ahead, left), or random when neither is given.

    `gait` and `style` make the sentence ("a person is jogging happily.") and the gait the speed; or give a `text`.
    """

    type: Literal["reach"] = "reach"
    position_m: tuple[Coordinate, Coordinate] | None = None
    relative_m: tuple[Coordinate, Coordinate] | None = None
    random_distance_m: tuple[Annotated[FiniteFloat, Field(gt=0)], Annotated[FiniteFloat, Field(le=30)]] = (1.0, 3.0)
    text: Text = WALK_TEXT
    gait: Gait | None = None
    style: Style | None = None
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
        if self.text != WALK_TEXT and (self.gait or self.style):
            raise ValueError("give a text, or gait and style, not both")
        return self

    @property
    def prompt(self) -> str:
        """What the planner is told."""
        if self.gait is None and self.style is None:
            return self.text
        words = [GAITS[self.gait or "walk"][0], *([self.style] if self.style else [])]
        return f"a person is {' '.join(words)}."

    @property
    def paced(self) -> ReachTuning:
        """The tuning, with the gait's speed unless it names one."""
        if self.gait is None or "speed_mps" in self.tuning.model_fields_set:
            return self.tuning
        return self.tuning.model_copy(update={"speed_mps": GAITS[self.gait][1]})


class HaltSpec(BaseTaskSpec):
    """Stop within `settle_s` and stand for `duration_s`."""

    type: Literal["halt"] = "halt"
    text: Text = STAND_TEXT
    settle_s: Annotated[FiniteFloat, Field(ge=0, le=10)] = 1.5
    duration_s: Annotated[FiniteFloat, Field(gt=0, le=120)] = 3.0
    drift_m: Annotated[FiniteFloat, Field(gt=0, le=5)] = 0.2
    guidance: Guidance | None = None


class TextSpec(BaseTaskSpec):
    """Do what the text says for `duration_s`."""

    type: Literal["text"] = "text"
    text: Text
    duration_s: Annotated[FiniteFloat, Field(gt=0, le=120)] = 5.0
    guidance: Guidance | None = None


class VelocitySpec(BaseTaskSpec):
    """Move at a velocity: `velocity_mps` in the world, or `relative_mps` (ahead, left) of where it faces at the start.

    Strict: after `settle_s` the mean velocity is within `tolerance_mps` of what was asked for, and no fall.
    """

    type: Literal["velocity"] = "velocity"
    velocity_mps: tuple[Speed, Speed] | None = None
    relative_mps: tuple[Speed, Speed] | None = None
    text: Text = WALK_TEXT
    duration_s: Annotated[FiniteFloat, Field(gt=0, le=120)] = 5.0
    settle_s: Annotated[FiniteFloat, Field(ge=0, le=10)] = 1.5
    tolerance_mps: Annotated[FiniteFloat, Field(gt=0, le=2)] = 0.3
    guidance: Guidance | None = None

    @model_validator(mode="after")
    def _one_velocity(self) -> VelocitySpec:
        if (self.velocity_mps is None) == (self.relative_mps is None):
            raise ValueError("give velocity_mps or relative_mps")
        if self.duration_s - self.settle_s < 0.1:
            raise ValueError("settle_s must be at least 0.1 s below duration_s")
        return self
