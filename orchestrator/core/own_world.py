"""What an open loop takes for true: its own plan, performed to the letter, among objects that stay where they were."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from orchestrator.core.stitch import PlanBuffer
from shared.motion.resampling import finite_velocity
from shared.protocol.messages import TICK_HZ
from shared.tasks.interface import BodyView, Trace
from shared.tasks.world import unfelt

Array = npt.NDArray[np.float64]

KEPT_FRAMES = {"closed_loop": 200, "open_loop": 1200}
"""So much of what was planned is kept: in an open loop a minute at 20 fps, longer than any task lasts, so that one can
be taken up again."""

Planned = Callable[[int, int], Array | None]
"""(N, 22, 3) joints in the world as planned at ticks start..stop-1; None where nothing is planned yet."""


def planned_at(buffer: PlanBuffer, start_tick: int, stop_tick: int) -> Array | None:
    """As `Planned`: linear between frames, so that a later plan changes no earlier tick; at the ends the pose there."""
    frames = buffer.held()
    if not len(frames):
        return None
    at = np.arange(start_tick, stop_tick) * buffer.fps / TICK_HZ - buffer.first_frame
    at = np.clip(at, 0.0, len(frames) - 1.0)
    left = np.floor(at + 1e-9).astype(int)
    part = np.maximum(at - left, 0.0)[:, None, None]
    return np.asarray(frames[left] * (1 - part) + frames[np.minimum(left + 1, len(frames) - 1)] * part)


def planned_prefix(
    buffer: PlanBuffer, simulated_w_m: Array, velocities_w_mps: Array, now_frame: int
) -> tuple[Array, Array]:
    """The frames planned up to `now_frame` and their velocities, as many as were simulated (N, 22, 3).

    Where nothing is planned, at the start and after a reset, the body begins where it was put: those frames are entered
    as what was planned.
    """
    oldest = now_frame - len(simulated_w_m) + 1
    if buffer.has(oldest):
        planned = buffer.get(oldest, now_frame + 1)
        return planned, finite_velocity(planned, buffer.fps)
    if not buffer.has(now_frame):
        buffer.put(oldest, simulated_w_m)
    return simulated_w_m, velocities_w_mps


def as_planned(view: BodyView, planned: Planned | None, objects: Mapping[str, Array] | None = None) -> BodyView:
    """The body as planned at a view's tick, which never falls, and objects at (7,) poses; the view itself where
    nothing is planned or `planned` is None, in a closed loop."""
    body = None if planned is None else planned(view.tick, view.tick + 1)
    if body is None:
        return view
    return replace(view, pos_w_m=body[0], fallen=False, objects=view.objects if objects is None else objects)


def trace_as_planned(trace: Trace, planned: Planned, objects: Mapping[str, Array]) -> Trace:
    """The same for a stretch of ticks; what touches what cannot be told there."""
    bodies = planned(trace.start_tick, trace.start_tick + len(trace)) if len(trace) else None
    if bodies is None:
        return trace
    return Trace(trace.start_tick, bodies, np.zeros(len(trace), dtype=bool), unfelt(objects, len(trace)))
