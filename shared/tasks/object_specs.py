"""Tasks with objects as data: `strike`, `sit`, `get_up`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import ConfigDict, Field, FiniteFloat

from shared.scenes.schema import Name, Scene
from shared.tasks.places import check_mark
from shared.tasks.specs import BaseTaskSpec, Guidance, Text, TimeLimit

Limb = Literal["left_hand", "right_hand", "left_foot", "right_foot"]
Metres = Annotated[FiniteFloat, Field(gt=0, le=5)]


class StrikeSpec(BaseTaskSpec):
    """Hit an object, such as the bag, with a hand or a foot so that it topples. A miss steps back and hits again.

    Attributes:
        mark: what to hit; it is on an object.
        height_m: hit at this height; None: at the mark's own.
        from_m, to_m, stand_m: a blow starts between these distances of pelvis and object over the floor; a body
            elsewhere goes to `stand_m` first. None: as suits the limb. A step that is part of a blow would put a foot
            against the object before the fist is there.
        blow_s: time that the planner is given from the start of a blow to its landing; None: as suits the limb.
    """

    type: Literal["strike"] = "strike"
    limb: Limb = "right_hand"
    mark: Name = "bag_centre"
    height_m: Annotated[FiniteFloat, Field(ge=0, le=3)] | None = None
    text: Text | None = None
    from_m: Metres | None = None
    to_m: Metres | None = None
    stand_m: Metres | None = None
    blow_s: Annotated[FiniteFloat, Field(ge=0.4, le=2)] | None = None
    time_limit_s: TimeLimit = 15.0
    guidance: Guidance | None = None

    @property
    def prompt(self) -> str:
        """What the planner is told."""
        if self.text is not None:
            return self.text
        side, end = self.limb.split("_")
        # Words that our planner has learnt: of those of the release it makes a step, or a blow half as far.
        return f"strike with the {side} hand" if end == "hand" else f"a person kicks with the {side} foot."

    def check(self, scene: Scene | None) -> None:
        """The mark is there, on an object."""
        check_mark(scene, self.mark, on_object=True)


class SitSpec(BaseTaskSpec):
    """Walk to a seat, turn round, sit down on it and stay.

    Attributes:
        mark: middle of the seat's top; where `X_centre` has an `X_front` beside it one sits down from there.
        above_m: the pelvis is aimed so far above the seat's top, as much as there is of the body below it.
    """

    type: Literal["sit"] = "sit"
    mark: Name = "seat_centre"
    text: Text = "a person is sitting down on a bench."
    above_m: Annotated[FiniteFloat, Field(ge=0, le=0.5)] = 0.12
    time_limit_s: TimeLimit = 17.0
    guidance: Guidance | None = None

    def check(self, scene: Scene | None) -> None:
        """The mark is there."""
        check_mark(scene, self.mark, on_object=True)


class GetUpSpec(BaseTaskSpec):
    """Get up, from a seat or from the floor, and stand.

    Attributes:
        from_: `from` in files.
        mark: the seat; not used on the floor.
        ahead_m: where to stand, in front of the seat's edge (REFERENCE 3).
        height_m: of the pelvis of someone who stands, for a body of canonical size.
        sit_first: who does not sit at the start sits down first, and has as long for that as `sit` has. A retry does,
            since an attempt that failed leaves the body elsewhere.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", populate_by_name=True, serialize_by_alias=True)
    type: Literal["get_up"] = "get_up"
    from_: Annotated[Literal["seat", "floor"], Field(alias="from")] = "seat"
    mark: Name = "seat_centre"
    text: Text | None = None
    ahead_m: Metres = 0.3
    height_m: Metres = 0.9
    sit_first: bool = False
    time_limit_s: TimeLimit = 13.0
    guidance: Guidance | None = None

    @property
    def prompt(self) -> str:
        """What the planner is told."""
        if self.text is not None:
            return self.text
        if self.from_ == "floor":
            return "a person gets up from the floor."
        return "a person is getting up from a bench and standing."

    def check(self, scene: Scene | None) -> None:
        """The seat is there, where one is needed."""
        if self.from_ == "seat":
            check_mark(scene, self.mark, on_object=True)

    def again(self) -> GetUpSpec:
        """From a seat it needs someone who sits."""
        return self if self.from_ == "floor" else self.model_copy(update={"sit_first": True})
