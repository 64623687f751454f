"""What becomes of a character that has fallen."""

from __future__ import annotations

from typing import Literal

from shared.motion.skeleton import CANONICAL
from shared.protocol.messages import TICK_HZ
from shared.tasks.interface import RISE_PLANNER, BodyView, PlanGoal

OnFall = Literal["stay", "reset", "get_up"]
"""`stay`: it lies until it is told otherwise. `reset`: it is put on its feet where it is. `get_up`: it gets up, by the
planner `rise` where the planner service has it, else by what the character's own planner makes of the words; where its
tracker cannot (`gets_up` of its declaration), or it takes too long, it is put on its feet."""

GET_UP_TEXT = "a person gets up from the floor."
GET_UP_S = 20.0
"""Who lies after so long is put on the feet: time for two ways up and a half."""
UP_SHARE = 0.85
"""Up is whose pelvis is at this share of its height in standing."""


def get_up_goal() -> PlanGoal:
    """What to ask for while a body that should get up does so. Lying is still a fall, and not what was asked for."""
    return PlanGoal(text=GET_UP_TEXT, may_be_low=False, planner=RISE_PLANNER)


class Down:
    """Whether a body is down: from its fall until it stands, the way up included.

    A body on its knees has no fall any more, but whoever took it over there with other plans would drop it.

    Attributes:
        is_so: as of the last state. since_tick: of the fall, while it is so.
    """

    def __init__(self) -> None:
        self.is_so = False
        self.since_tick = 0

    def update(self, view: BodyView) -> bool:
        """Take a new state; whether the body is down."""
        low = float(view.pos_w_m[0, 2]) < UP_SHARE * CANONICAL.root_height_m * view.scale
        was, self.is_so = self.is_so, view.fallen or (self.is_so and low)
        if not was:
            self.since_tick = view.tick
        return self.is_so

    def too_long(self, tick: int) -> bool:
        """Whether it has been down for so long that it will hardly get up."""
        return self.is_so and tick - self.since_tick > GET_UP_S * TICK_HZ

    def clear(self) -> None:
        """The body was put on its feet."""
        self.is_so = False
