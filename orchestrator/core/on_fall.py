"""What becomes of a character that has fallen."""

from __future__ import annotations

from typing import Literal

from shared.tasks.interface import PlanGoal

OnFall = Literal["stay", "reset", "get_up"]
"""`stay`: it lies until it is told otherwise. `reset`: it is put on its feet where it is. `get_up`: the planner is
asked for getting up until it stands."""

GET_UP_TEXT = "a person gets up from the floor."


def get_up_goal() -> PlanGoal:
    """What to ask for while a body that should get up lies."""
    return PlanGoal(text=GET_UP_TEXT)
