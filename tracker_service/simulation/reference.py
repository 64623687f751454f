"""The motion a character is asked to follow: plans on absolute frames at their own rate, read as 30 Hz ticks.

Frame f lies at f / fps s, tick t at t / 30 s; a plan starts at a tick that is a frame (`shared.protocol.rates`) and
fills the frames after it. Ticks come from frames by index-aligned resampling, then inverse kinematics and hinge angles;
positions are made anew from those by forward kinematics, so that the reference is a pose the character can take. After
its last frame a plan goes on into a balanced stand.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.errors import InvalidInputError
from shared.motion.heading import heading_of
from shared.motion.ik import rotations_from_positions, standing_pose
from shared.motion.kinematics import forward_kinematics
from shared.motion.resampling import resample, sample_at
from shared.motion.rotations import (
    matrix_from_rotvec,
    quat_from_matrix,
    rotvec_from_matrix,
)
from shared.motion.skeleton import CANONICAL
from shared.protocol.rates import PLANNER_FPS, TICK_HZ, frame_of_tick, last_frame_by, start_spacing
from tracker_service.simulation.humanoid import Humanoid
from tracker_service.simulation.kinematics import BodyKinematics, qpos_from_motion

Array = npt.NDArray[np.float64]

HISTORY_FRAMES = 12
"""Frames before a change that enter its resampling, at least."""
STAND_S = 0.5
"""A finished plan turns into a stand over half a second, and stays for another."""
MAX_AHEAD_TICKS = 600
STAND_UP_HEIGHT_M = 0.7
"""A plan that ends with the pelvis lower than this (sitting, lying) is held, not turned into a stand."""
MAX_COAST_MPS = 2.0


@dataclass(frozen=True)
class ReferenceTicks:
    """Reference at T consecutive ticks. J bodies, H hinges.

    Attributes:
        pos_w_m: (T, J, 3). linvel_w_mps: (T, J, 3). quat_w: (T, J, 4). qpos: (T, 7+H).
    """

    pos_w_m: Array
    linvel_w_mps: Array
    quat_w: Array
    qpos: Array

    @property
    def hinges_rad(self) -> Array:
        """(T, H)."""
        return self.qpos[:, 7:]

    def rows(self, index: npt.NDArray[np.int64]) -> ReferenceTicks:
        """The ticks at these rows."""
        return ReferenceTicks(self.pos_w_m[index], self.linvel_w_mps[index], self.quat_w[index], self.qpos[index])


def central_velocity(pos: npt.NDArray[np.floating], rate_hz: float) -> npt.NDArray[np.floating]:
    """Central differences (T, ...) per second along the first axis, one-sided at the ends."""
    out = np.empty_like(pos)
    out[1:-1] = (pos[2:] - pos[:-2]) * (rate_hz / 2)
    out[0] = (pos[1] - pos[0]) * rate_hz
    out[-1] = (pos[-1] - pos[-2]) * rate_hz
    return out


def reference_ticks(
    human: Humanoid, kinematics: BodyKinematics, positions_w_m: npt.ArrayLike, previous_hinges: Array | None = None
) -> ReferenceTicks:
    """Reference from joint positions (T, J, 3) at 30 Hz, T >= 2.

    Args:
        previous_hinges: (H,) angles at the first tick that a hinge's branch is continued from.
    """
    positions = np.asarray(positions_w_m, dtype=np.float64)
    local = rotations_from_positions(positions, human.skeleton)
    hinges = human.hinges.angles(local, previous_hinges)
    qpos = qpos_from_motion(human, positions[:, 0], local, hinges)
    pos, rot = kinematics.poses(qpos)
    velocity = np.asarray(central_velocity(pos, TICK_HZ))
    return ReferenceTicks(np.asarray(pos), velocity, quat_from_matrix(rot), np.asarray(qpos, dtype=np.float64))


class ReferenceBuffer:
    """What is to be followed, from a little before now until the end of the last plan, which it holds for ever."""

    def __init__(self, human: Humanoid, tick: int, xy_w_m: tuple[float, float], heading_rad: float):
        """Start with standing at a place, at the rate of the built-in planners; `tick` is a frame there."""
        self._human = human
        self._kinematics = BodyKinematics(human)
        local = standing_pose(human.skeleton, heading_rad)[None]
        root = np.array([[*xy_w_m, human.skeleton.root_height_m]])
        pose, _ = forward_kinematics(human.skeleton, root, local)
        self._fps: int = PLANNER_FPS
        self._first_frame = frame_of_tick(tick, self._fps) - HISTORY_FRAMES
        self._frames = np.repeat(pose, HISTORY_FRAMES + self._stand_frames, axis=0)
        self.plan_end_tick = tick
        self._first_tick = self._tick_of(self._first_frame)
        self._ticks = reference_ticks(human, self._kinematics, resample(self._frames, self._fps, TICK_HZ))

    @property
    def _stand_frames(self) -> int:
        return max(2, round(STAND_S * self._fps))

    def _tick_of(self, frame: int) -> int:
        """Tick of a frame that is one."""
        return frame * TICK_HZ // self._fps

    def _tick_frame_by(self, frame: int) -> int:
        """Last frame at or before `frame` that is a tick."""
        spacing = start_spacing(self._fps) * self._fps // TICK_HZ
        return frame // spacing * spacing

    @property
    def last_tick(self) -> int:
        """Ticks after this one are equal to it."""
        return self._first_tick + len(self._ticks.qpos) - 1

    def at(self, tick: int, count: int = 1) -> ReferenceTicks:
        """Reference at `count` ticks from `tick` on; beyond the end the last pose, before the start the first."""
        index = np.clip(np.arange(tick, tick + count) - self._first_tick, 0, len(self._ticks.qpos) - 1)
        return self._ticks.rows(index)

    def copy(self) -> ReferenceBuffer:
        """An independent buffer; the arrays are shared, since no method changes one in place."""
        return copy(self)

    def insert(
        self, start_tick: int, positions_w_m: npt.NDArray[np.floating], now_tick: int, fps: int = PLANNER_FPS
    ) -> None:
        """Put a plan in: its frame i at (start_tick / 30 + (i + 1) / fps) s. Ticks up to `now_tick` stay as they were.

        Raises:
            InvalidInputError: start tick between two frames, or too far back or ahead of what is held.
        """
        frame = frame_of_tick(start_tick, fps)
        if start_tick < self._first_tick:
            raise InvalidInputError(
                f"start_tick {start_tick} is past", field="start_tick", allowed=f">= {self._first_tick}"
            )
        if fps != self._fps:
            self._change_rate(fps)
        kept = self._frames[: frame + 1 - self._first_frame]
        missing = frame + 1 - self._first_frame - len(kept)
        # Counted from now and not from the last plan: after a long time without one the next is still welcome.
        if start_tick > now_tick + MAX_AHEAD_TICKS:
            raise InvalidInputError(
                f"start_tick {start_tick} is too far ahead",
                field="start_tick",
                allowed=f"<= {now_tick + MAX_AHEAD_TICKS}",
            )
        if missing > 0:
            kept = np.concatenate([kept, np.repeat(kept[-1:], missing, axis=0)])
        plan = np.asarray(positions_w_m, dtype=np.float64)
        tail = self._stand_after(np.concatenate([kept[-1:], plan])[-2:])
        self._frames = np.concatenate([kept, plan, tail])
        self.plan_end_tick = (frame + len(plan)) * TICK_HZ // fps
        self._recompute(max(start_tick, now_tick), frame)
        self._trim(now_tick)

    def _recompute(self, keep_through_tick: int, frame: int) -> None:
        changed = min(frame, last_frame_by(keep_through_tick, self._fps))
        begin = max(self._first_frame, self._tick_frame_by(changed - HISTORY_FRAMES))
        begin_tick = self._tick_of(begin)
        at_begin = self.at(begin_tick).hinges_rad[0]
        window = resample(self._frames[begin - self._first_frame :], self._fps, TICK_HZ)
        fresh = reference_ticks(self._human, self._kinematics, window, at_begin)
        keep = keep_through_tick + 1 - self._first_tick
        old = self.at(self._first_tick, keep)
        new = fresh.rows(np.arange(keep_through_tick + 1 - begin_tick, len(window)))
        pos = np.concatenate([old.pos_w_m, new.pos_w_m])
        # The old tick's velocity stays; that of the first new one is seen from the old tick it follows.
        velocity = np.concatenate([old.linvel_w_mps, np.asarray(central_velocity(pos[keep - 1 :], TICK_HZ))[1:]])
        self._ticks = ReferenceTicks(
            pos, velocity, np.concatenate([old.quat_w, new.quat_w]), np.concatenate([old.qpos, new.qpos])
        )

    def _change_rate(self, fps: int) -> None:
        """Go on at another planner's rate: the frames at hand are resampled, the ticks stay as they are."""
        old_fps, old_first = self._fps, self._first_frame
        self._fps = fps
        first_tick = self._first_tick // start_spacing(fps) * start_spacing(fps)
        first = frame_of_tick(first_tick, fps)
        last = (old_first + len(self._frames) - 1) * fps // old_fps
        # The new grid may begin a little before what is held: the first pose is held there.
        old = np.arange(first, last + 1) * (old_fps / fps) - old_first
        self._frames = sample_at(self._frames, np.clip(old, 0, len(self._frames) - 1))
        missing = self._first_tick - first_tick
        self._ticks = self._ticks.rows(np.maximum(np.arange(-missing, len(self._ticks.qpos)), 0))
        self._first_frame, self._first_tick = first, first_tick

    def _trim(self, now_tick: int) -> None:
        begin = self._tick_frame_by(last_frame_by(now_tick, self._fps) - 4 * HISTORY_FRAMES)
        if begin <= self._first_frame:
            return
        self._frames = self._frames[begin - self._first_frame :]
        drop = self._tick_of(begin) - self._first_tick
        self._ticks = self._ticks.rows(np.arange(drop, len(self._ticks.qpos)))
        self._first_frame, self._first_tick = begin, self._tick_of(begin)

    def _stand_after(self, last_two: Array) -> Array:
        """Frames that lead from the end of a plan (2, J, 3) into a stand at the same place and heading, and stay."""
        skeleton = self._human.skeleton
        end = last_two[-1]
        frames = self._stand_frames
        if end[0, 2] < STAND_UP_HEIGHT_M * skeleton.height_m / CANONICAL.height_m:
            return np.repeat(end[None], 2 * frames, axis=0)
        local = rotations_from_positions(end[None], skeleton)[0]
        stand = standing_pose(skeleton, float(heading_of(local[0][:, 0])))
        coast = (last_two[1, 0] - last_two[0, 0])[:2] * self._fps
        speed = float(np.linalg.norm(coast))
        coast *= min(1.0, MAX_COAST_MPS / max(speed, 1e-9))
        s = np.minimum(np.arange(1, 2 * frames + 1) / frames, 1.0)
        blend = s * s * (3 - 2 * s)
        way = rotvec_from_matrix(local.swapaxes(-1, -2) @ stand)
        poses = local @ matrix_from_rotvec(blend[:, None, None] * way)
        root = np.repeat(end[None, 0], len(s), axis=0)
        root[:, :2] += (s - s * s / 2)[:, None] * coast * (frames / self._fps)
        root[:, 2] += blend * (skeleton.root_height_m - end[0, 2])
        return np.asarray(forward_kinematics(skeleton, root, poses)[0])

    def to_arrays(self) -> dict[str, npt.NDArray[np.generic]]:
        """Everything it holds, for a snapshot."""
        ticks = self._ticks
        return {
            "frames": self._frames,
            "pos": ticks.pos_w_m,
            "vel": ticks.linvel_w_mps,
            "quat": ticks.quat_w,
            "qpos": ticks.qpos,
            "marks": np.array([self._first_frame, self._first_tick, self.plan_end_tick, self._fps], dtype=np.int64),
        }

    def from_arrays(self, arrays: Mapping[str, npt.NDArray[np.generic]]) -> None:
        """Take over what `to_arrays` gave."""
        self._frames = np.asarray(arrays["frames"], dtype=np.float64)
        pos, vel, quat, qpos = (np.asarray(arrays[k], dtype=np.float64) for k in ("pos", "vel", "quat", "qpos"))
        self._ticks = ReferenceTicks(pos, vel, quat, qpos)
        self._first_frame, self._first_tick, self.plan_end_tick, self._fps = (int(v) for v in arrays["marks"])
