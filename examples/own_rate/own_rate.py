"""Two planners with rates and lengths of their own; the loop cuts, resamples and joins as their specs say.

`drift` plans half a second at 30 fps from a single frame: it goes as fast as it is asked to, or to its target, and
faces where it should. `sway` looks back two seconds: it goes to its target while its limbs do what they just did,
backwards.
Explained in docs/writing_a_planner.md.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from shared.motion.heading import body_heading
from shared.motion.ik import clip_from_positions
from shared.motion.rotations import matrix_about_z, wrap_angle
from shared.motion.skeleton import CANONICAL
from shared.plugins.interfaces import Planner, PlannerSpec
from shared.protocol.messages import TICK_HZ, Plan, PlanRequest

TOP_SPEED_MPS = 1.5
TOP_TURN_RADPS = 2.0
Array = npt.NDArray[np.float64]


def way_to_go(request: PlanRequest, times_s: Array) -> Array:
    """(T, 3) how far to have gone at these times after the start: with the velocity asked for, else to the target."""
    way = np.zeros((len(times_s), 3))
    root = np.asarray(request.prefix_positions_w_m[-1, 0, :2], dtype=np.float64)
    gaps = [(np.array(t.position_w_m[:2]) - root, t.arrival_tick) for t in request.targets if t.joint == "traj"]
    if request.desired_velocity_w_mps is not None:
        way[:, :2] = times_s[:, None] * np.array(request.desired_velocity_w_mps)
    elif gaps:
        gap, tick = gaps[0]
        due_s = (tick - request.start_tick) / TICK_HZ
        seconds = max(due_s, float(np.linalg.norm(gap)) / TOP_SPEED_MPS, 0.05)
        way[:, :2] = np.minimum(times_s / seconds, 1.0)[:, None] * gap
    return way


def turning(request: PlanRequest, times_s: Array) -> Array:
    """(T, 22, 3) the present pose around its pelvis, turning to where it should face."""
    pose = np.asarray(request.prefix_positions_w_m[-1], dtype=np.float64)
    turn_rad = 0.0 if request.facing_rad is None else float(wrap_angle(request.facing_rad - body_heading(pose)))
    angles = np.sign(turn_rad) * np.minimum(times_s * TOP_TURN_RADPS, abs(turn_rad))
    return np.asarray((pose - pose[0]) @ np.swapaxes(matrix_about_z(angles), -1, -2))


def swaying(request: PlanRequest, times_s: Array) -> Array:
    """(T, 22, 3) the poses of the prefix around the last one's pelvis, backwards and forwards again."""
    past = np.asarray(request.prefix_positions_w_m, dtype=np.float64)
    back = np.arange(1, len(times_s) + 1) % (2 * len(past) - 2)
    poses = past[::-1][np.minimum(back, 2 * len(past) - 2 - back)]
    height = past[-1, 0] * np.array([0.0, 0.0, 1.0])
    return np.asarray(poses - poses[:, :1] * np.array([1.0, 1.0, 0.0]) - height)


class OwnRatePlanner:
    """Moves limbs along a way.

    Args:
        spec: says rate, lengths and conditions; the requests are made to it.
        limbs: (T, 22, 3) the body around where its pelvis is at the start, at times (T,) after it.
    """

    def __init__(self, spec: PlannerSpec, limbs: Callable[[PlanRequest, Array], Array]):
        self.spec = spec
        self._limbs = limbs

    def plan(self, requests: list[PlanRequest]) -> list[Plan]:
        """One plan for each request, in order."""
        return [self._plan(request) for request in requests]

    def _plan(self, request: PlanRequest) -> Plan:
        times_s = np.arange(1, request.horizon_frames + 1) / self.spec.fps
        at = np.asarray(request.prefix_positions_w_m[-1, 0], dtype=np.float64)
        positions = self._limbs(request, times_s) + at + way_to_go(request, times_s)[:, None]
        clip = clip_from_positions(positions, self.spec.fps, rebuild=True)
        return Plan(
            planner=self.spec.name,
            start_tick=request.start_tick,
            fps=self.spec.fps,
            positions_w_m=clip.positions_w_m,
            rotations_6d=clip.rotations_6d,
            seed=request.seed,
        )


def make_drift() -> Planner:
    """What the entry point names: called without arguments, once."""
    spec = PlannerSpec(
        name="drift", version="1", skeleton=CANONICAL.id, fps=30, prefix_frames=1, plan_frames=15, replan_frames=9,
        conditions=("target", "velocity", "facing"),
    )  # fmt: skip
    return OwnRatePlanner(spec, turning)


def make_sway() -> Planner:
    """The same for the other."""
    spec = PlannerSpec(
        name="sway", version="1", skeleton=CANONICAL.id, fps=20, prefix_frames=40, plan_frames=40,
        conditions=("target",),
    )  # fmt: skip
    return OwnRatePlanner(spec, swaying)
