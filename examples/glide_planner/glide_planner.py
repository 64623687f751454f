"""A planner of our own: keeps the present pose and glides to the target. Explained in docs/writing_a_planner.md."""

from __future__ import annotations

import numpy as np

from shared.motion.heading import body_heading
from shared.motion.ik import clip_from_positions
from shared.motion.rotations import matrix_about_z, wrap_angle
from shared.motion.skeleton import CANONICAL
from shared.plugins.interfaces import Planner, PlannerSpec
from shared.protocol.messages import PLANNER_FPS, TICK_HZ, Plan, PlanRequest

TOP_SPEED_MPS = 1.5
TOP_TURN_RADPS = 2.0


class GlidePlanner:
    """Moves the last pose towards a target for `traj` in a straight line, and turns as it is asked to."""

    spec = PlannerSpec(
        name="glide", version="1", skeleton=CANONICAL.id, fps=PLANNER_FPS, prefix_frames=1, plan_frames=200,
        conditions=("target", "heading"),
    )  # fmt: skip

    def plan(self, requests: list[PlanRequest]) -> list[Plan]:
        """One plan for each request, in order."""
        return [self._plan(request) for request in requests]

    def _plan(self, request: PlanRequest) -> Plan:
        pose = np.asarray(request.prefix_positions_w_m[-1], dtype=np.float64)  # (22, 3), world, metres
        times_s = np.arange(1, request.horizon_frames + 1) / PLANNER_FPS  # frame i is 1/20 s after frame i - 1
        way = np.zeros((len(times_s), 3))
        for target in request.targets:
            if target.joint == "traj":
                gap = np.array(target.position_w_m[:2]) - pose[0, :2]
                due_s = (target.arrival_tick - request.start_tick) / TICK_HZ
                seconds = max(due_s, float(np.linalg.norm(gap)) / TOP_SPEED_MPS, 0.05)
                way[:, :2] = np.minimum(times_s / seconds, 1.0)[:, None] * gap
        angles_rad = np.zeros(len(times_s))
        if request.heading is not None:
            turn_rad = float(wrap_angle(request.heading.heading_rad - body_heading(pose)))
            angles_rad = np.sign(turn_rad) * np.minimum(times_s * TOP_TURN_RADPS, abs(turn_rad))
        turned = (pose - pose[0]) @ np.swapaxes(matrix_about_z(angles_rad), -1, -2)
        # Bones keep their length and the rotations fit the positions: `rebuild` sees to both.
        clip = clip_from_positions(pose[0] + way[:, None] + turned, PLANNER_FPS, rebuild=True)
        return Plan(
            planner=self.spec.name,
            start_tick=request.start_tick,
            positions_w_m=clip.positions_w_m,
            rotations_6d=clip.rotations_6d,
            seed=request.seed,
        )


def make_planner() -> Planner:
    """What the entry point names: called without arguments, once."""
    return GlidePlanner()
