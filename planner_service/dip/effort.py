"""How hard a plan is for legs, and how much guidance a body that moves bears."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from shared.motion.heading import hips_heading
from shared.protocol.messages import PLANNER_FPS, Plan, PlanRequest
from shared.tasks.obey import asks_floor_seat
from shared.text.wording import STAND_TEXT

EASED_MPS = (1.2, 2.0)
"""Speeds between which guidance fades to none."""
STANDS_MPS = 0.6
"""Whoever goes faster comes to a stand first, in the usual manner: less guided, a runner runs on with waving arms."""
SPEED_FRAMES = 4


def words_alone(request: PlanRequest) -> bool:
    """Whether nothing but its text says what a request asks for, and the text counts."""
    told = request.targets or request.heading is not None or len(request.keyframe_ticks) > 0
    return not told and request.desired_velocity_w_mps is None and request.guidance != 0.0


def speed_mps(request: PlanRequest) -> float:
    """How fast the pelvis goes over the floor at the end of a request's prefix."""
    root = request.prefix_positions_w_m[-SPEED_FRAMES - 1 :, 0, :2].astype(np.float64)
    return float(np.linalg.norm(root[-1] - root[0])) * PLANNER_FPS / max(len(root) - 1, 1)


def eased(guidance: float, speed_mps: float) -> float:
    """Guidance for a body at a speed: above 1 it fades to 1 (none) between EASED_MPS.

    Guidance pulls toward what is typical of a text, and what is typical of waving or jumping on the spot is to stand:
    of twelve runners at 2.5 m/s that were told to wave, plans with guidance 5 stopped the pelvis over the feet within
    half a second, which throws a body, those with 1 ran on for 0.4 s and slowed down over the next half.
    """
    low, high = EASED_MPS
    share = min(max((speed_mps - low) / (high - low), 0.0), 1.0)
    return guidance if guidance <= 1.0 else guidance + share * (1.0 - guidance)


STOPS_FIRST = ("step_back", "walk_back", "step_side")
"""Meanings that a body which goes ahead is not planned for before it stands: of a run most plans run on for seconds."""
JUMPS, JUMPS_MPS = ("jump", "hop", "jump_turn", "jump_reach", "jumping_jack"), 1.0
"""The same for jumps on the spot, of whoever goes faster: of 71 runners and walkers told to jump, 11 fell."""
WALKS, RUNNING_MPS, WALKING_MPS = ("walk",), 1.9, 1.3
"""Who is told to walk while running is told how fast, too: a run is as good a walk to a network that is shown one."""


RUNS, STARTS_MPS, WALK_TEXT = ("run", "run_start"), 0.5, "a person walks forward"
"""Who stands and is told to run walks first: of 120 who leant into a run at once 5 fell, of 120 who did not none."""


def led_up_to(request: PlanRequest, meaning: str | None) -> PlanRequest:
    """The request, as one for what comes before: a stand or a slower way where what a text means is not done so fast,
    a walk where a run begins."""
    if not words_alone(request) or request.guidance is not None or meaning is None:
        return request
    action, speed, pelvis = meaning.partition(":")[0], speed_mps(request), request.prefix_positions_w_m[:, 0, :2]
    way = (pelvis[-1] - pelvis[-1 - SPEED_FRAMES]).astype(np.float64)
    if action in WALKS and speed > RUNNING_MPS:
        x, y = (float(part) for part in way * WALKING_MPS / np.linalg.norm(way))
        return request.model_copy(update={"desired_velocity_w_mps": (x, y)})
    if action in RUNS and speed < STARTS_MPS:
        return request.model_copy(update={"text": WALK_TEXT})
    if action in JUMPS and speed > JUMPS_MPS:
        return request.model_copy(update={"text": STAND_TEXT})
    if (action in STOPS_FIRST or asks_floor_seat(request.text)) and speed > STANDS_MPS:
        heading = float(hips_heading(request.prefix_positions_w_m[-1]))
        if way[0] * np.cos(heading) + way[1] * np.sin(heading) > 0:
            return request.model_copy(update={"text": STAND_TEXT})
    return request


EASIER_GUIDANCE = 1.5
LEGS_MPS2 = 3.5
"""A plan that changes the pelvis' speed faster is made again with less guidance, unless the request gives its own.
Eight bodies that stood and were told to run had plans that gained 4.0 m/s2 (median) with guidance 5, 3.1 with 1.5."""
SPAN_FRAMES = 6


def hardest_mps2(positions_w_m: npt.NDArray[np.floating]) -> float:
    """Fastest change of the pelvis' speed over the floor, over SPAN_FRAMES, in motion (T, J, 3) at PLANNER_FPS."""
    step = np.linalg.norm(np.diff(positions_w_m[:, 0, :2].astype(np.float64), axis=0), axis=-1) * PLANNER_FPS
    smooth = np.convolve(step, np.ones(3) / 3, "valid")
    if len(smooth) <= SPAN_FRAMES:
        return 0.0
    return float(np.abs(smooth[SPAN_FRAMES:] - smooth[:-SPAN_FRAMES]).max()) * PLANNER_FPS / SPAN_FRAMES


def too_hard(request: PlanRequest, plan: Plan, guidance: float) -> bool:
    """Whether legs may not follow a plan, and less guidance may help."""
    if request.guidance is not None or request.text is None or guidance <= EASIER_GUIDANCE:
        return False
    motion = np.concatenate([request.prefix_positions_w_m[-SPAN_FRAMES:], plan.positions_w_m])
    return hardest_mps2(motion) > LEGS_MPS2
