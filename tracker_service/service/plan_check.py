"""Whether a plan may be followed: shape, skeleton, finite, near the character, no faster than a body can be."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from shared.errors import InvalidInputError
from shared.motion.skeleton import Skeleton
from shared.protocol.messages import TICK_HZ, Track
from tracker_service.service.settings import TrackerServiceSettings

FloatArray = npt.NDArray[np.floating]


def check_plan(track: Track, skeleton: Skeleton, root_w_m: FloatArray, limits: TrackerServiceSettings) -> None:
    """Raise InvalidInputError, naming the field, for a plan that must not be followed.

    Args:
        track: the message; its array types and finiteness were checked when it was decoded.
        skeleton: of the character.
        root_w_m: (3,) where the character's pelvis is now.
        limits: reach_m, plan_speed_mps, joint_speed_mps.
    """
    if track.skeleton != skeleton.id:
        raise InvalidInputError(f"the plan is for skeleton {track.skeleton!r}", field="skeleton", allowed=skeleton.id)
    positions = np.asarray(track.positions_w_m, dtype=np.float64)
    if len(positions) == 0:
        raise InvalidInputError("the plan has no frames", field="positions_w_m", allowed="1 to 4096 frames")
    time_s = (np.arange(len(positions)) + 1) / track.fps
    allowed_m = limits.reach_m + limits.plan_speed_mps * time_s
    distance_m = np.linalg.norm(positions - root_w_m, axis=-1).max(axis=-1)
    if (distance_m > allowed_m).any():
        frame = int(np.argmax(distance_m - allowed_m))
        raise InvalidInputError(
            f"frame {frame} has a joint {distance_m[frame]:.1f} m from the character",
            field="positions_w_m",
            allowed=f"within {allowed_m[frame]:.1f} m of the character at that frame",
        )
    if len(positions) > 1:
        speed_mps = np.linalg.norm(np.diff(positions, axis=0), axis=-1) * track.fps
        if speed_mps.max() > limits.joint_speed_mps:
            frame, joint = (int(i) for i in np.unravel_index(np.argmax(speed_mps), speed_mps.shape))
            raise InvalidInputError(
                f"{skeleton.names[joint]} moves at {speed_mps[frame, joint]:.1f} m/s after frame {frame}",
                field="positions_w_m",
                allowed=f"<= {limits.joint_speed_mps:g} m/s",
            )


def late_reason(track: Track, tick: int, limits: TrackerServiceSettings) -> str | None:
    """Why a sound plan comes too late to be of use, or None."""
    late = tick - track.start_tick
    if late >= limits.late_ticks:
        return f"{late} ticks late, {limits.late_ticks} or more are too many"
    last_tick = track.start_tick + len(track.positions_w_m) * TICK_HZ / track.fps
    if last_tick <= tick:
        return f"the plan ends at tick {last_tick:g}, and it is tick {tick} now"
    return None
