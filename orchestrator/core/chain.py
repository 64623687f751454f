"""Plans one after the other as one: the longer variant of the loop, in which nothing is looked at in between."""

from __future__ import annotations

import numpy as np

from shared.errors import InvalidInputError
from shared.protocol.messages import Plan, PlanRequest
from shared.protocol.rates import TICK_HZ, frame_of_tick


def following(request: PlanRequest, plan: Plan, seed: int) -> PlanRequest:
    """The request for what comes after a plan: the same wishes, and a prefix that is the plan's own end.

    Raises InvalidInputError where the plan does not end at a tick that is one of its frames.
    """
    ticks, rest = divmod(len(plan.positions_w_m) * TICK_HZ, plan.fps)
    start_tick = plan.start_tick + ticks
    if rest:
        raise InvalidInputError("such plans cannot be chained: they end between two ticks", field="chained_plans")
    frame_of_tick(start_tick, plan.fps)
    wanted = len(request.prefix_positions_w_m)
    positions = np.concatenate([request.prefix_positions_w_m, plan.positions_w_m])[-wanted - 1 :]
    velocities = np.diff(positions, axis=0) * plan.fps
    update = {
        "start_tick": start_tick,
        "prefix_positions_w_m": positions[-wanted:],
        "prefix_rotations_6d": np.concatenate([request.prefix_rotations_6d, plan.rotations_6d])[-wanted:],
        "prefix_velocities_w_mps": velocities.astype("<f4"),
        "context_frames": wanted,
        "seed": seed,
    }
    return request.model_copy(update=update)


def chained(first: Plan, second: Plan) -> Plan:
    """Both as one plan from the first's start; the timings are added."""
    timings = {name: first.timings_ms.get(name, 0.0) + ms for name, ms in second.timings_ms.items()}
    return first.model_copy(
        update={
            "positions_w_m": np.concatenate([first.positions_w_m, second.positions_w_m]),
            "rotations_6d": np.concatenate([first.rotations_6d, second.rotations_6d]),
            "timings_ms": {**first.timings_ms, **timings},
        }
    )
