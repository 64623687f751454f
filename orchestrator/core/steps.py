"""A command as it is understood: its text without what it says not to do, and one step after the other."""

from __future__ import annotations

from orchestrator.core.command import Command, CommandGoal
from shared.protocol.rates import TICK_HZ
from shared.tasks.interface import BodyView, PlanGoal
from shared.text.wording import Wording, understand

STEP_S = 4.0
"""How long each step of "walk, then wave" is done; the last one holds until the next command."""


class SteppedGoal:
    """What a command asks of the planner at every plan while it holds.

    Args:
        command: as given.
        issued_tick: when; steps and arrivals count from here.
    """

    def __init__(self, command: Command, issued_tick: int):
        self.command = command
        self.wording: Wording | None = None if command.text is None else understand(command.text)
        self._issued_tick = issued_tick
        texts = [None] if self.wording is None else self.wording.steps
        self._goals = [CommandGoal(command.model_copy(update={"text": text}), issued_tick) for text in texts]

    def __call__(self, view: BodyView, plan_tick: int) -> PlanGoal:
        """The goal of a plan that starts at `plan_tick`."""
        step = int((plan_tick - self._issued_tick) // (STEP_S * TICK_HZ))
        return self._goals[min(max(step, 0), len(self._goals) - 1)](view, plan_tick)
