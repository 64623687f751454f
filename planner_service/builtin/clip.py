"""The planner `clip`: plays recorded motion, chosen by the words of the text and the pose at hand.

Among the clips whose words fit, the frame most like the last prefix frame (pose and velocity as seen from the body) is
where playing goes on, so that plan follows plan without a seam. The clip is turned and shifted onto the prefix, what
difference is left decays, and the path is bent toward a `traj` or `pelvis` target or a heading.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt

from planner_service.builtin.library import ClipLibrary, LibraryClip, pose_features
from planner_service.builtin.stand import coming_to_rest, plan_of
from shared.motion.features import rotate_z
from shared.motion.heading import body_heading, heading_of
from shared.motion.metrics import sole_points
from shared.motion.resampling import finite_velocity
from shared.motion.rotations import wrap_angle
from shared.motion.skeleton import CANONICAL
from shared.plugins.interfaces import PlannerSpec
from shared.protocol.messages import PLANNER_FPS, Plan, PlanRequest

Array = npt.NDArray[np.float64]

ARRIVED_M = 0.2
"""Nearer than this to its target the character comes to a stand."""
MAX_TURN_RADPS = 1.5
LEAST_PACE = 0.2
SEAM_RATE = 8.0
"""Decay rate (1/s) of what differs between prefix and clip at the seam; critically damped."""
ACTIVITY_BONUS_S = 0.15
"""How much nearer (m per m/s) a frame counts for what happens after it: an idle start would be played for ever."""
ACTIVE_MPS = 0.6
"""More activity than this counts no more, or the fastest clip would always win."""
FLOOR_TARGETS = ("traj", "pelvis")


class ClipPlanner:
    """Plays clips of a library. Honours text, floor targets and heading."""

    def __init__(self, library: ClipLibrary):
        self._matching = lru_cache(maxsize=256)(library.matching)
        self.spec = PlannerSpec(
            name="clip", version="1", skeleton=CANONICAL.id, fps=PLANNER_FPS, prefix_frames=1, plan_frames=200,
            conditions=("text", "target", "heading"),
        )  # fmt: skip

    def plan(self, requests: list[PlanRequest]) -> list[Plan]:
        """One plan for each request; the seed changes nothing."""
        return [self._plan(request) for request in requests]

    def _plan(self, request: PlanRequest) -> Plan:
        last = np.asarray(request.prefix_positions_w_m[-1], dtype=np.float64)
        velocity = np.asarray(request.prefix_velocities_w_mps[-1], dtype=np.float64)
        goals = [target for target in request.targets if target.joint in FLOOR_TARGETS]
        way = np.array(goals[0].position_w_m[:2]) - last[0, :2] if goals else None
        candidates = self._candidates(request, way)
        if candidates:
            positions = self._play(candidates, last, velocity, request.horizon_frames)
            heading = request.heading.heading_rad if request.heading is not None else None
            turn = _turn(positions, way, heading)
            positions = bend(positions, turn, 1.0 if way is None else _pace(positions, way, turn))
            positions[:, :, 2] += np.maximum(0.0, -sole_points(positions)[..., 2].min(axis=-1))[:, None]
            positions = positions[1:]
        else:
            positions = coming_to_rest(request)
        ignored = [f"target:{t.joint}" for t in request.targets if t.joint not in FLOOR_TARGETS]
        return plan_of(self.spec.name, request, positions, ignored)

    def _candidates(self, request: PlanRequest, way: Array | None) -> list[LibraryClip]:
        """Clips to play; none to come to a stand."""
        if way is not None and np.linalg.norm(way) < ARRIVED_M:
            return []
        found = self._matching(request.text) if request.text else []
        if not found and way is not None:
            found = self._matching("walk")
        return found

    def _play(self, clips: list[LibraryClip], last: Array, velocity: Array, horizon: int) -> Array:
        """(horizon + 1, 22, 3): the last prefix frame and the clip from its best frame on, joined to it."""
        now = pose_features(last[None], velocity[None])[0]
        best, clip, start = np.inf, clips[0], 0
        for candidate in clips:
            length = len(candidate.positions_w_m)
            free = max(1, length - horizon)
            cost = np.linalg.norm(candidate.features[:free] - now, axis=-1)
            cost = cost - ACTIVITY_BONUS_S * np.minimum(candidate.activity_mps[:free], ACTIVE_MPS)
            frame = int(np.argmin(cost))
            if cost[frame] < best:
                best, clip, start = float(cost[frame]), candidate, frame
        piece = clip.positions_w_m[np.minimum(np.arange(start, start + horizon + 1), len(clip.positions_w_m) - 1)]
        turn = np.array(body_heading(last) - body_heading(piece[0]))
        aligned = rotate_z(piece - piece[0, 0] * np.array([1.0, 1.0, 0.0]), turn)
        aligned = aligned + last[0] * np.array([1.0, 1.0, 0.0])
        moving = finite_velocity(aligned[:2], PLANNER_FPS)[1]
        offset, rate = last - aligned[0], velocity - moving
        t = (np.arange(horizon + 1) / PLANNER_FPS)[:, None, None]
        return np.asarray(aligned + (offset + (rate + SEAM_RATE * offset) * t) * np.exp(-SEAM_RATE * t))


def _turn(positions: Array, way: Array | None, heading: float | None) -> float:
    """By how much (rad) the path should bend over its length, to point along `way`, or to end facing `heading`."""
    if way is not None:
        travel = positions[-1, 0, :2] - positions[0, 0, :2]
        facing = float(body_heading(positions[0]))
        course = float(heading_of(travel)) if np.linalg.norm(travel) > 0.3 else facing
        return float(wrap_angle(heading_of(way) - course))
    if heading is not None:
        return float(wrap_angle(heading - float(body_heading(positions[-1]))))
    return 0.0


def _pace(positions: Array, way: Array, turn_rad: float) -> float:
    """Share of the clip's way to go: less with the target at one's side, and no farther than the target."""
    travel_m = float(np.linalg.norm(np.diff(positions[:, 0, :2], axis=0), axis=-1).sum())
    within = float(np.linalg.norm(way)) / max(travel_m, 1e-6)
    return float(np.clip(min(np.cos(turn_rad), within), LEAST_PACE, 1.0))


def bend(positions: Array, turn_rad: float, pace: float = 1.0) -> Array:
    """The motion (T, 22, 3) with path and heading turned evenly by `turn_rad`, at most MAX_TURN_RADPS.

    `pace` shortens the way: a target at one's side is never reached by walking round it at full pace.
    """
    steps = len(positions) - 1
    rate = float(np.clip(turn_rad / max(0.5, 0.6 * steps / PLANNER_FPS), -MAX_TURN_RADPS, MAX_TURN_RADPS))
    angle = np.arange(steps + 1) / PLANNER_FPS * rate
    angle = np.sign(rate) * np.minimum(np.abs(angle), abs(turn_rad))
    root = positions[:, 0] * np.array([1.0, 1.0, 0.0])
    moved = pace * rotate_z(np.diff(root, axis=0), angle[1:])
    path = np.concatenate([root[:1], root[0] + np.cumsum(moved, axis=0)])
    return np.asarray(rotate_z(positions - root[:, None], angle[:, None]) + path[:, None])
