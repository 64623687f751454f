"""Settings of the loop."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

REPLAN_TICKS = 15
"""The usual period of plans with a target."""


class LoopSettings(BaseModel):
    """How plans are requested and joined.

    Attributes:
        mode: `closed_loop`: prefix and goals come from what the simulation did; `open_loop`: from the plan itself, the
            physics is never looked at (for comparison, REFERENCE 3; `core.own_world`).
        replan_ticks: a new plan every so many ticks at 30 Hz; 60 is the paper's loop, 15 and 120 its variants.
        text_replan_ticks: the same for plans without a target. A plan that is cut off early never gets far into what
            its text says: from standing, its first half second is still standing, again and again.
        least_ticks: the least that a plan runs before one for a new command takes over (see `core.pacing`).
        plan_lead_ticks: a plan is requested so many ticks ahead of its start (by the clock at least so many, see
            `core.lead`); 0 plans from the present state.
        horizon_frames: length of a plan at 20 fps.
        chained_plans: so many plans, each going on from the end of the one before, are asked for and performed as one.
        error_decay_s: time in which the tracking error added to the old plan's rest dies out.
        guidance: classifier-free guidance for commands that name none; None for the planner's own default.
        plan_timeout_s, tracker_timeout_s: deadline of one request.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")
    mode: Literal["closed_loop", "open_loop"] = "closed_loop"
    replan_ticks: Annotated[int, Field(ge=3, le=300, multiple_of=3)] = REPLAN_TICKS
    text_replan_ticks: Annotated[int, Field(ge=3, le=300, multiple_of=3)] = 30
    least_ticks: Annotated[int, Field(ge=3, le=60, multiple_of=3)] = 9
    plan_lead_ticks: Annotated[int, Field(ge=0, le=60)] = 0
    horizon_frames: Annotated[int, Field(ge=4, le=200)] = 40
    chained_plans: Annotated[int, Field(ge=1, le=4)] = 1
    error_decay_s: Annotated[FiniteFloat, Field(gt=0, le=5)] = 0.5
    guidance: Annotated[FiniteFloat, Field(ge=0, le=20)] | None = None
    plan_timeout_s: Annotated[FiniteFloat, Field(gt=0, le=600)] = 30.0
    tracker_timeout_s: Annotated[FiniteFloat, Field(gt=0, le=600)] = 30.0

    def period_ticks(self, aims: bool, sooner: int | None = None) -> int:
        """Ticks from a plan to the next for a goal with a target, or without; `sooner` is the goal's own wish, which
        settings that plan seldom on purpose do not grant."""
        usual = self.replan_ticks if aims else self.text_replan_ticks
        return usual if sooner is None or self.replan_ticks > REPLAN_TICKS else min(usual, sooner)


LOCKSTEP = LoopSettings()
REALTIME = LoopSettings(plan_lead_ticks=3, plan_timeout_s=3.0, tracker_timeout_s=15.0)

VARIANTS: dict[str, LoopSettings] = {
    "closed_loop": LoopSettings(),
    "open_loop": LoopSettings(mode="open_loop"),
    "no_finetune": LoopSettings(),
    "paper": LoopSettings(replan_ticks=60, text_replan_ticks=60),
    "short": LoopSettings(replan_ticks=15, text_replan_ticks=15, horizon_frames=10),
    "long": LoopSettings(replan_ticks=120, text_replan_ticks=120, chained_plans=2),
}
"""Loop variants by the names of DESIGN 8. `paper` is the paper's blocking loop: a plan of 40 frames, performed to its
end before the body is looked at again. `short` looks at it four times as often, with plans of 10 frames; `long` half as
often, with two plans of 40 in a chain. `no_finetune` is `closed_loop` with weights that one names for it, of
a tracker that has seen no plans."""
