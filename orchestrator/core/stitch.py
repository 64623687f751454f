"""Joining plans: the buffer of what was planned, and the prefix that the next plan starts from.

Frames are absolute planner frames: frame f is at f / 20 s, so that tick t (t / 30 s) divisible by 3 is frame 2 t / 3.
Pure numpy; nothing here talks to a service.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.errors import InvalidInputError
from shared.protocol.messages import PLANNER_FPS, TICK_HZ

Array = npt.NDArray[np.float64]

PREFIX_FRAMES = 20
DECAY_S = 0.5


def frame_of_tick(tick: int) -> int:
    """Planner frame at a tick divisible by 3; raises InvalidInputError for other ticks, which lie between frames."""
    if tick % 3:
        raise InvalidInputError(f"tick {tick} is no planner frame", field="tick", allowed="multiples of 3")
    return tick * PLANNER_FPS // TICK_HZ


def last_frame_by(tick: int) -> int:
    """Last planner frame at or before `tick`."""
    return tick * PLANNER_FPS // TICK_HZ


def start_tick_for(now_tick: int, lead_ticks: int) -> int:
    """First tick divisible by 3 that is at least `lead_ticks` after `now_tick`."""
    return -(-(now_tick + lead_ticks) // 3) * 3


class PlanBuffer:
    """World positions of the plan by absolute frame: a new plan replaces everything after its first frame."""

    def __init__(self) -> None:
        self._first = 0
        self._positions: Array = np.zeros((0, 0, 3))

    @property
    def first_frame(self) -> int:
        """First frame held (meaningless while empty)."""
        return self._first

    @property
    def end_frame(self) -> int:
        """One past the last frame held; equal to `first_frame` while empty."""
        return self._first + len(self._positions)

    def clear(self) -> None:
        """Forget every plan (after a reset, or when the character was moved)."""
        self._positions = np.zeros((0, 0, 3))

    def put(self, first_frame: int, positions_w_m: npt.ArrayLike, keep_frames: int = 200) -> None:
        """Enter a plan.

        Args:
            first_frame: absolute frame of its first row.
            positions_w_m: (T, J, 3).
            keep_frames: how many frames before it are kept.
        """
        new = np.asarray(positions_w_m, dtype=np.float64)
        if len(self._positions) and self._first < first_frame <= self.end_frame:
            old = self._positions[: first_frame - self._first][-keep_frames:]
            self._first = first_frame - len(old)
            self._positions = np.concatenate([old, new])
        else:
            self._first, self._positions = first_frame, new.copy()

    def has(self, frame: int) -> bool:
        """Whether `frame` is in the buffer."""
        return self._first <= frame < self.end_frame

    def get(self, start: int, stop: int) -> Array:
        """Frames start..stop-1, (stop-start, J, 3); the last frame is held past the end.

        Raises:
            InvalidInputError: the buffer is empty or begins after `start`.
        """
        if not len(self._positions) or start < self._first:
            raise InvalidInputError(
                f"frame {start} is not planned", field="start", allowed=f"{self._first}..{self.end_frame - 1}"
            )
        index = np.minimum(np.arange(start, stop) - self._first, len(self._positions) - 1)
        return self._positions[index]


def since(simulated_w_m: npt.ArrayLike, last_frame: int, first_frame: int) -> Array:
    """Simulated frames (N, J, 3), the last at `last_frame`, with those before `first_frame` replaced by that one.

    After a reset the log still holds what came before it: a prefix over both would jump.
    """
    simulated = np.asarray(simulated_w_m, dtype=np.float64)
    index = np.arange(len(simulated))
    return simulated[np.clip(index, min(len(simulated) - 1 - (last_frame - first_frame), len(simulated) - 1), None)]


def error_decay(elapsed_s: npt.ArrayLike, decay_s: float = DECAY_S) -> Array:
    """Weight of the present tracking error after `elapsed_s`: 1 at 0, 0 from `decay_s` on, smooth at both ends."""
    u = np.clip(np.asarray(elapsed_s, dtype=np.float64) / decay_s, 0.0, 1.0)
    return np.asarray(1.0 - u * u * (3.0 - 2.0 * u))


@dataclass(frozen=True)
class Prefix:
    """What a planner continues. P frames at 20 fps, the last one at the plan's start tick.

    Attributes:
        positions_w_m: (P, J, 3).
        velocities_w_mps: (P, J, 3), backward differences (the first row uses the frame before the prefix).
        context_frames: how many of the last frames are the rest of the old plan, not simulated.
    """

    positions_w_m: Array
    velocities_w_mps: Array
    context_frames: int


def build_prefix(
    simulated_w_m: npt.ArrayLike,
    last_simulated_frame: int,
    end_frame: int,
    buffer: PlanBuffer,
    prefix_frames: int = PREFIX_FRAMES,
    decay_s: float = DECAY_S,
) -> Prefix:
    """Prefix that ends at `end_frame`: simulated frames, then the part of the old plan still to be played.

    The difference between the simulation and the old plan at the last simulated frame is added to that part and decays
    over `decay_s`, so that the junction has no jump (DESIGN 6). Where no plan covers the gap the last pose is held.

    Args:
        simulated_w_m: (N, J, 3) simulated frames, the last one at `last_simulated_frame`, N >= prefix_frames + 1.
        last_simulated_frame: absolute frame of its last row.
        end_frame: absolute frame the plan starts from, >= last_simulated_frame.
        buffer: what was planned before.
    """
    simulated = np.asarray(simulated_w_m, dtype=np.float64)
    gap = end_frame - last_simulated_frame
    if gap < 0:
        raise InvalidInputError(
            f"the prefix ends {-gap} frames before now", field="end_frame", allowed=f">= {last_simulated_frame}"
        )
    if len(simulated) < prefix_frames + 1:
        raise InvalidInputError(
            f"{len(simulated)} simulated frames", field="simulated_w_m", allowed=f">= {prefix_frames + 1} frames"
        )
    parts = [simulated]
    if gap:
        now = simulated[-1]
        if buffer.has(last_simulated_frame):
            planned = buffer.get(last_simulated_frame, end_frame + 1)
            weight = error_decay(np.arange(1, gap + 1) / PLANNER_FPS, decay_s)
            rest = planned[1:] + weight[:, None, None] * (now - planned[0])
        else:
            rest = np.repeat(now[None], gap, axis=0)
        parts.append(rest)
    frames = np.concatenate(parts)[-(prefix_frames + 1) :]
    return Prefix(frames[1:], np.diff(frames, axis=0) * PLANNER_FPS, min(gap, prefix_frames))
