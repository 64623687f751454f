"""Joining plans: the buffer of what was planned, and the prefix that the next plan starts from.

Frames are absolute frames at the planner's own rate: frame f is at f / fps s (`shared.protocol.rates` says which ticks
are frames). Pure numpy; nothing here talks to a service.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.errors import InvalidInputError
from shared.motion.resampling import sample_at
from shared.protocol.rates import PLANNER_FPS, TICK_HZ, first_start_by, last_frame_by, start_spacing

Array = npt.NDArray[np.float64]

DECAY_S = 0.5


def start_tick_for(now_tick: int, lead_ticks: int, fps: int = PLANNER_FPS) -> int:
    """First tick that is a frame at `fps` and at least `lead_ticks` after `now_tick`."""
    return first_start_by(now_tick + lead_ticks, fps)


class PlanBuffer:
    """World positions of the plan by absolute frame at `fps`: a new plan replaces everything after its first frame."""

    def __init__(self, fps: int = PLANNER_FPS) -> None:
        self.fps = fps
        self._first = 0
        self._positions: Array = np.zeros((0, 0, 3))

    def at_rate(self, fps: int) -> PlanBuffer:
        """What is planned, for a planner of that rate: the frames of its grid that lie within it."""
        if fps == self.fps:
            return self
        out = PlanBuffer(fps)
        if len(self._positions):
            first = -(-self._first * fps // self.fps)
            last = (self.end_frame - 1) * fps // self.fps
            there = np.arange(first, last + 1) * self.fps / fps - self._first
            out._first, out._positions = first, sample_at(self._positions, there)
        return out

    @property
    def first_frame(self) -> int:
        """First frame held (meaningless while empty)."""
        return self._first

    @property
    def end_frame(self) -> int:
        """One past the last frame held; equal to `first_frame` while empty."""
        return self._first + len(self._positions)

    def held(self) -> Array:
        """All frames held, (T, J, 3), from `first_frame` on."""
        return self._positions.copy()

    def clear(self) -> None:
        """Forget every plan (after a reset, or when the character was moved)."""
        self._first, self._positions = 0, np.zeros((0, 0, 3))

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


def since(
    simulated_w_m: npt.ArrayLike, velocities_w_mps: npt.ArrayLike, last_frame: int, first_frame: int
) -> tuple[Array, Array]:
    """Simulated frames and velocities (N, J, 3), the last at `last_frame`, as if it stood still before `first_frame`.

    After a reset the log still holds what came before it: a prefix over both would jump.
    """
    simulated = np.asarray(simulated_w_m, dtype=np.float64)
    index = np.arange(len(simulated))
    first = min(len(simulated) - 1 - (last_frame - first_frame), len(simulated) - 1)
    still = index < first
    velocities = np.where(still[:, None, None], 0.0, np.asarray(velocities_w_mps, dtype=np.float64))
    return simulated[np.maximum(index, first)], velocities


def error_decay(elapsed_s: npt.ArrayLike, decay_s: float = DECAY_S) -> Array:
    """Weight of the present tracking error after `elapsed_s`: 1 at 0, 0 from `decay_s` on, smooth at both ends."""
    u = np.clip(np.asarray(elapsed_s, dtype=np.float64) / decay_s, 0.0, 1.0)
    return np.asarray(1.0 - u * u * (3.0 - 2.0 * u))


@dataclass(frozen=True)
class LogWindow:
    """Which part of the log holds a prefix: what to ask for, and the rows of the answer that are the frames.

    Attributes:
        start_tick, stop_tick: of the range, at the planner's rate.
        skip: rows before the first frame wanted.
        frames: how many are wanted, the last at `last_frame`.
        last_frame: the last frame at or before now.
    """

    start_tick: int
    stop_tick: int
    skip: int
    frames: int
    last_frame: int

    def rows(self, samples: npt.ArrayLike) -> Array:
        """The frames wanted (frames, ...) of the samples that came, which may go on beyond them."""
        return np.asarray(samples, dtype=np.float64)[self.skip : self.skip + self.frames]


def log_window(now_tick: int, prefix_frames: int, fps: int) -> LogWindow:
    """The range of the log with the `prefix_frames` frames up to now and the one before them.

    A range begins at a tick, and frames are its samples where that tick is a frame.
    """
    last = last_frame_by(now_tick, fps)
    first = last - prefix_frames
    spacing = start_spacing(fps)
    frames_a_spacing = spacing * fps // TICK_HZ
    begin = first // frames_a_spacing
    return LogWindow(begin * spacing, now_tick + 1, first - begin * frames_a_spacing, prefix_frames + 1, last)


@dataclass(frozen=True)
class Prefix:
    """What a planner continues. P frames at its rate, the last one at the plan's start tick.

    Attributes:
        positions_w_m: (P, J, 3).
        velocities_w_mps: (P, J, 3) the simulation's own; backward differences in the rest of the old plan.
        context_frames: how many of the last frames are the rest of the old plan, not simulated.
    """

    positions_w_m: Array
    velocities_w_mps: Array
    context_frames: int


def build_prefix(
    simulated_w_m: npt.ArrayLike,
    velocities_w_mps: npt.ArrayLike,
    last_simulated_frame: int,
    end_frame: int,
    buffer: PlanBuffer,
    prefix_frames: int,
    decay_s: float = DECAY_S,
) -> Prefix:
    """Prefix that ends at `end_frame`: simulated frames, then the part of the old plan still to be played.

    The difference between the simulation and the old plan at the last simulated frame is added to that part and decays
    over `decay_s`, so that the junction has no jump (DESIGN 6). Where no plan covers the gap the last pose is held.

    Args:
        simulated_w_m, velocities_w_mps: (N, J, 3) simulated frames and their velocities, the last one at
            `last_simulated_frame`, N >= prefix_frames.
        last_simulated_frame: absolute frame of its last row.
        end_frame: absolute frame the plan starts from, >= last_simulated_frame.
        buffer: what was planned before; its rate is that of all frames.
        prefix_frames: how many frames the planner wants.
    """
    simulated = np.asarray(simulated_w_m, dtype=np.float64)
    gap = end_frame - last_simulated_frame
    if gap < 0:
        raise InvalidInputError(
            f"the prefix ends {-gap} frames before now", field="end_frame", allowed=f">= {last_simulated_frame}"
        )
    if len(simulated) < prefix_frames:
        raise InvalidInputError(
            f"{len(simulated)} simulated frames", field="simulated_w_m", allowed=f">= {prefix_frames} frames"
        )
    parts, speeds = [simulated], [np.asarray(velocities_w_mps, dtype=np.float64)]
    if gap:
        now = simulated[-1]
        first = max(last_simulated_frame, buffer.first_frame)
        if first <= end_frame and buffer.has(first):
            # A plan that has still to begin counts too: until then its first frame is where the body is going.
            planned = buffer.get(first, end_frame + 1)
            planned = np.concatenate([np.repeat(planned[:1], first - last_simulated_frame, axis=0), planned])
            weight = error_decay(np.arange(1, gap + 1) / buffer.fps, decay_s)
            rest = planned[1:] + weight[:, None, None] * (now - planned[0])
        else:
            rest = np.repeat(now[None], gap, axis=0)
        parts.append(rest)
        speeds.append(np.diff(np.concatenate([now[None], rest]), axis=0) * buffer.fps)
    frames, velocities = (np.concatenate(rows)[-prefix_frames:] for rows in (parts, speeds))
    return Prefix(frames, velocities, min(gap, prefix_frames))
