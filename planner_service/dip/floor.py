"""Sitting on the floor: recorded only on the way to lying down, and so planned for as that, held where it sits.

Of a text that asks for it the network knows sitting, which it knows on seats, and plans a chair of air: of nine bodies
that were told to sit down on the floor nine fell on their backs.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from planner_service.dip.effort import words_alone
from shared.motion.heading import hips_heading
from shared.motion.ik import clip_from_positions
from shared.motion.skeleton import CANONICAL
from shared.protocol.messages import PLANNER_FPS, Plan, PlanRequest
from shared.tasks.obey import asks_floor_seat

Array = npt.NDArray[np.float64]

WAY_DOWN = "a person lies down on the floor"
SEATED_M = 0.25
"""A pelvis this low is on the floor."""
HEAD_M = 0.6
"""Whose head sinks lower is leaning back to lie down."""
EASE_FRAMES = 4
"""In about so many frames the motion comes to rest."""
LEAN_RAD, RAISE_FRAMES = 0.2, 12
"""The trunk is raised until it leans back no more than this, within so many frames: on its hands no body stays up."""
_LEGS = ("pelvis", "hip", "knee", "ankle", "foot")
UPPER = [i for i, name in enumerate(CANONICAL.names) if not name.endswith(_LEGS)]


def is_floor_seat(request: PlanRequest) -> bool:
    """Whether a request asks by its words alone for sitting on the floor."""
    return words_alone(request) and asks_floor_seat(request.text)


def way_down(request: PlanRequest) -> PlanRequest:
    """The request as it is planned for."""
    return request.model_copy(update={"text": WAY_DOWN})


def held_seated(request: PlanRequest, plan: Plan) -> Plan:
    """A plan of `way_down` that comes to rest where it sits, as the plan of the request."""
    motion = np.concatenate([request.prefix_positions_w_m[-1:], plan.positions_w_m]).astype(np.float64)
    rest = sits_from(motion)
    if rest is not None:
        clip = clip_from_positions(upright(at_rest(motion, rest), rest)[1:], PLANNER_FPS)
        plan = plan.model_copy(update={"positions_w_m": clip.positions_w_m, "rotations_6d": clip.rotations_6d})
    return plan.model_copy(update={"understood": None})


def sits_from(motion_w_m: Array) -> int | None:
    """Frame of a motion (T, 22, 3) from which on it would lean back from sitting on the floor; None without one."""
    back = (motion_w_m[:, 0, 2] < SEATED_M) & (motion_w_m[:, CANONICAL.index("head"), 2] < HEAD_M)
    return max(int(back.argmax()) - EASE_FRAMES, 0) if back.any() else None


def at_rest(motion_w_m: Array, rest: int) -> Array:
    """(T, 22, 3) the motion up to a frame, from where on it slows down and stops within EASE_FRAMES of its own."""
    frame = np.arange(len(motion_w_m), dtype=np.float64)
    late = EASE_FRAMES * (1.0 - np.exp(-np.maximum(frame - rest, 0.0) / EASE_FRAMES))
    at = np.minimum(np.minimum(frame, rest) + late, len(frame) - 1)
    low = np.floor(at).astype(int)
    high = np.minimum(low + 1, len(frame) - 1)
    share = (at - low)[:, None, None]
    return (1.0 - share) * motion_w_m[low] + share * motion_w_m[high]


def upright(motion_w_m: Array, since: int) -> Array:
    """(T, 22, 3) with the trunk raised from a frame on until it leans back by LEAN_RAD at most."""
    out = motion_w_m.copy()
    heading = hips_heading(motion_w_m)
    ahead = np.stack([np.cos(heading), np.sin(heading)], -1)
    head = motion_w_m[:, CANONICAL.index("head")] - motion_w_m[:, 0]
    lean = np.arctan2(-(head[:, :2] * ahead).sum(-1), head[:, 2])
    share = np.clip((np.arange(len(lean)) - since) / RAISE_FRAMES, 0.0, 1.0)
    angle = np.maximum(lean - LEAN_RAD, 0.0) * share * share * (3.0 - 2.0 * share)
    axis = np.stack([-ahead[:, 1], ahead[:, 0], np.zeros_like(lean)], -1)
    turn = Rotation.from_rotvec(angle[:, None] * axis).as_matrix()
    above = motion_w_m[:, UPPER] - motion_w_m[:, :1]
    out[:, UPPER] = motion_w_m[:, :1] + np.einsum("tij,tkj->tki", turn, above)
    return out
