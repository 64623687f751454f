"""Plans made by forward kinematics and small helpers for the tracker service's tests."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from shared.motion.kinematics import forward_kinematics
from shared.motion.rotations import matrix_from_axis_angle, matrix_to_6d
from shared.motion.skeleton import CANONICAL
from shared.protocol.messages import GetTicks, StateFrame, Step, TickRange, Track
from shared.protocol.transport import ServiceClient

FloatArray = npt.NDArray[np.floating]


def standing_plan(frames: int, *, sway_rad: float = 0.25, xy_m: tuple[float, float] = (0.0, 0.0)) -> FloatArray:
    """(frames, 22, 3) standing with hanging arms that swing at 1 Hz, which a PD servo can follow."""
    local = np.tile(np.eye(3), (frames, len(CANONICAL), 1, 1))
    time_s = (np.arange(frames) + 1) / 20

    def turn(joint: str, axis: tuple[float, float, float], angle: FloatArray) -> None:
        j = CANONICAL.index(joint)
        local[:, j] = local[:, j] @ matrix_from_axis_angle(np.tile(np.array(axis), (frames, 1)), angle)

    swing = sway_rad * np.sin(2 * np.pi * time_s)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        turn(f"{side}_shoulder", (0.0, 1.0, 0.0), sign * swing)
        turn(f"{side}_shoulder", (1.0, 0.0, 0.0), np.full(frames, -sign * 1.35))
        turn(f"{side}_elbow", (0.0, 0.0, 1.0), np.full(frames, -sign * 0.4))
    root = np.tile([*xy_m, CANONICAL.root_height_m], (frames, 1))
    return forward_kinematics(CANONICAL, root, local)[0]


def track(start_tick: int, positions: FloatArray, **changes: object) -> Track:
    """A Track message with identity rotations, which the tracker does not take from the plan."""
    rotations = np.tile(matrix_to_6d(np.eye(3)), (len(positions), len(CANONICAL), 1))
    values: dict[str, object] = {"start_tick": start_tick, "positions_w_m": positions, "rotations_6d": rotations}
    return Track(**{**values, **changes})


def step(client: ServiceClient, character_id: str, ticks: int) -> StateFrame:
    """Advance a lockstep character."""
    return client.ask(Step(ticks=ticks), StateFrame, character_id, timeout_s=30.0)


def ticks(client: ServiceClient, character_id: str, start: int, stop: int, rate_hz: int = 60) -> TickRange:
    """A range of the log with its reference."""
    message = GetTicks(start_tick=start, stop_tick=stop, rate_hz=rate_hz, include_reference=True)
    return client.ask(message, TickRange, character_id, timeout_s=10.0)


def same(a: TickRange | StateFrame, b: TickRange | StateFrame) -> bool:
    """Whether two ranges, or two states, are equal bit for bit."""
    return all(
        np.array_equal(x, getattr(b, name)) if isinstance(x := getattr(a, name), np.ndarray) else x == getattr(b, name)
        for name in type(a).model_fields
    )
