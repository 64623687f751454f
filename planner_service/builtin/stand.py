"""The planner `stand`: from the last prefix frame into relaxed standing at the same place, and stay there.

Every joint first goes on as it moved, its speed fading, and is drawn into the standing pose by a minimum-jerk weight;
the feet step there one after the other. So the plan starts with the prefix's position and velocity and ends at rest.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from shared.motion.body import SIDES
from shared.motion.heading import body_heading
from shared.motion.ik import clip_from_positions, standing_pose
from shared.motion.kinematics import forward_kinematics
from shared.motion.limbs import solve_leg
from shared.motion.skeleton import CANONICAL
from shared.plugins.interfaces import PlannerSpec
from shared.protocol.messages import PLANNER_FPS, Plan, PlanRequest

Array = npt.NDArray[np.float64]

SETTLE_S = 0.7
"""Time to come to rest from a slow gait."""
FADE_S = 0.15
"""Time constant with which the prefix's velocity fades."""
CAPTURE_S = 0.31
"""sqrt(hip height / g): a walker comes to rest this many seconds of its velocity ahead (capture point)."""
MAX_RUN_OUT_M = 0.6
STEP_HEIGHT_M = 0.06
PLANTED_MPS = 0.4
"""A foot slower than this stays where it is until it is its turn to step."""
KNEE_GIVE_M = 0.02
"""How much lower than with straight legs the root stands."""
STEP_FROM_M = 0.04
"""A foot nearer than this to where it shall stand is not lifted."""


def minimum_jerk(phase: npt.ArrayLike) -> Array:
    """10 p^3 - 15 p^4 + 6 p^5 with p held in [0, 1]: from 0 to 1 with no speed or acceleration at the ends."""
    p = np.clip(np.asarray(phase, dtype=np.float64), 0.0, 1.0)
    return p**3 * (10.0 - 15.0 * p + 6.0 * p**2)


def standing_positions(xy_w_m: npt.ArrayLike, heading_rad: float) -> Array:
    """(22, 3) relaxed standing with the root above a floor point, soles on the floor, knees not locked."""
    x, y = np.asarray(xy_w_m, dtype=np.float64)
    root = np.array([x, y, CANONICAL.root_height_m])
    positions, _ = forward_kinematics(CANONICAL, root, standing_pose(CANONICAL, heading_rad))
    ankles = {side: positions[CANONICAL.index(f"{side}_ankle")].copy() for side in SIDES}
    positions[:, 2] -= KNEE_GIVE_M
    for side in SIDES:
        positions = solve_leg(positions[None], side, ankles[side][None])[0]
    return positions


def settle(last_w_m: npt.ArrayLike, velocity_w_mps: npt.ArrayLike, times_s: npt.ArrayLike) -> Array:
    """Positions (T, 22, 3) at `times_s` after a frame (22, 3) with joint velocities (22, 3)."""
    last = np.asarray(last_w_m, dtype=np.float64)
    velocity = np.asarray(velocity_w_mps, dtype=np.float64)
    t = np.asarray(times_s, dtype=np.float64)
    run_out = CAPTURE_S * velocity[0, :2]
    run_out *= min(1.0, MAX_RUN_OUT_M / max(float(np.linalg.norm(run_out)), 1e-9))
    end = standing_positions(last[0, :2] + run_out, float(body_heading(last)))
    drop_m = max(0.0, CANONICAL.root_height_m - float(last[0, 2]) - 0.1)
    phase = t / (SETTLE_S + 0.3 * float(np.linalg.norm(velocity[0, :2])) + 1.5 * drop_m)

    coasting = last + velocity * FADE_S * (1.0 - np.exp(-t / FADE_S))[:, None, None]
    weight = minimum_jerk(phase)[:, None, None]
    out: Array = (1.0 - weight) * coasting + weight * end
    speed = {side: float(np.linalg.norm(velocity[CANONICAL.index(f"{side}_ankle")])) for side in SIDES}
    first = max(SIDES, key=lambda side: speed[side])
    for side in SIDES:
        ankle, foot = CANONICAL.indices(f"{side}_ankle", f"{side}_foot")
        moving = speed[side] > PLANTED_MPS
        begin, stop = (0.0 if moving or side == first else 0.25), (0.6 if side == first else 1.0)
        swing = np.clip((phase - begin) / (stop - begin), 0.0, 1.0)
        along = minimum_jerk(swing)[:, None]
        start = coasting[:, ankle] if moving else last[ankle]
        path = (1.0 - along) * start + along * end[ankle]
        on_floor = last[ankle, 2] < end[ankle, 2] + STEP_HEIGHT_M
        if on_floor and np.linalg.norm(end[ankle, :2] - last[ankle, :2]) > STEP_FROM_M:
            path[:, 2] += STEP_HEIGHT_M * np.sin(np.pi * swing) ** 2
        path[:, 2] = np.maximum(path[:, 2], min(last[ankle, 2], end[ankle, 2]))
        direction = (1.0 - along) * (last[foot] - last[ankle]) + along * (end[foot] - end[ankle])
        out[:, foot] = out[:, ankle] + direction
        out = solve_leg(out, side, path)
    return out


def coming_to_rest(request: PlanRequest) -> Array:
    """Positions (T, 22, 3) that a plan for `request` has which ends in a stand; see `settle`."""
    times_s = np.arange(1, request.horizon_frames + 1) / PLANNER_FPS
    return settle(request.prefix_positions_w_m[-1], request.prefix_velocities_w_mps[-1], times_s)


def plan_of(planner: str, request: PlanRequest, positions_w_m: Array, ignored: Sequence[str] = ()) -> Plan:
    """The plan of a built-in planner from its positions (T, 22, 3), with the rotations that IK gives them."""
    clip = clip_from_positions(positions_w_m, PLANNER_FPS, rebuild=True)
    return Plan(
        planner=planner,
        start_tick=request.start_tick,
        positions_w_m=clip.positions_w_m,
        rotations_6d=clip.rotations_6d,
        seed=request.seed,
        ignored_conditions=list(ignored),
    )


class StandPlanner:
    """Relaxed standing where the character is. Honours no condition."""

    spec = PlannerSpec(
        name="stand", version="1", skeleton=CANONICAL.id, fps=PLANNER_FPS, prefix_frames=1, plan_frames=200
    )

    def plan(self, requests: list[PlanRequest]) -> list[Plan]:
        """One plan for each request."""
        return [self._plan(request) for request in requests]

    def _plan(self, request: PlanRequest) -> Plan:
        return plan_of(self.spec.name, request, coming_to_rest(request))
