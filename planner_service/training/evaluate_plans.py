"""Single plans that continue held-out windows: how near they come to places and headings that the windows came to."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from planner_service.dip.conditions import JOINT_SLOTS
from planner_service.training.dataset import Material, WindowSampler
from planner_service.training.evaluate_quality import quality
from planner_service.training.windows import window_positions
from shared.motion.heading import body_heading
from shared.motion.rotations import wrap_angle
from shared.motion.skeleton import CANONICAL
from shared.plugins.interfaces import Planner
from shared.protocol.messages import HeadingTarget, JointTarget, PlanRequest
from shared.protocol.rates import PLANNER_FPS as FPS
from shared.protocol.rates import TICK_HZ

Array = npt.NDArray[np.float64]
BATCH = 16
LIMBS = ("pelvis", "left_foot", "right_foot", "left_wrist", "right_wrist")
"""What `target_error_m` is the median over; head and traj are told by themselves."""


def plans(
    planner: Planner, material: Material, windows: int, seed: int, advance: Callable[[int], None] = lambda n: None
) -> dict[str, object]:
    """Each window's plan is asked for one joint's place at an arrival frame and for the last heading, as they were.

    Half of the arrivals are at the plan's end, half at every even frame from the 8th to it.

    Returns:
        `target_error_m`, a median over LIMBS, and by joint; `heading_error_deg`, a median at the last frame; `plans`
        with the quality of these plans beside their windows'.
    """
    prefix, plan = planner.spec.prefix_frames, planner.spec.plan_frames
    batch = WindowSampler(material, prefix, plan, seed, augment=False).draw(windows)
    truth = window_positions(batch.features.numpy())
    rng = np.random.default_rng(seed)
    requests, asked = [], []
    for i in range(windows):
        slot = JOINT_SLOTS[i % len(JOINT_SLOTS)]
        joint = CANONICAL.index("pelvis" if slot == "traj" else slot)
        frame = plan if rng.random() < 0.5 else int(rng.integers(4, plan // 2 + 1)) * 2
        place = truth[i, prefix + frame - 1, joint] * (1, 1, 0 if slot == "traj" else 1)
        asked.append((slot, joint, frame, place))
        requests.append(
            PlanRequest(
                start_tick=0,
                prefix_positions_w_m=truth[i, :prefix],
                prefix_rotations_6d=np.zeros((prefix, 22, 6)),
                prefix_velocities_w_mps=np.zeros((prefix, 22, 3)),
                text=material.sentences[batch.sentence[i]],
                targets=[JointTarget(joint=slot, position_w_m=tuple(place), arrival_tick=frame * TICK_HZ // FPS)],
                heading=HeadingTarget(
                    heading_rad=float(body_heading(truth[i, -1])), arrival_tick=plan * TICK_HZ // FPS
                ),
                seed=seed + i,
            )
        )
    made = []
    for at in range(0, windows, BATCH):
        made += planner.plan(requests[at : at + BATCH])
        advance(len(requests[at : at + BATCH]))
    error: dict[str, list[float]] = {}
    turn = []
    for i, ((slot, joint, frame, place), one) in enumerate(zip(asked, made, strict=True)):
        axes = 2 if slot == "traj" else 3
        gap = one.positions_w_m[frame - 1, joint, :axes] - place[:axes]
        error.setdefault(slot, []).append(float(np.linalg.norm(gap)))
        turn.append(abs(wrap_angle(body_heading(one.positions_w_m[-1]) - body_heading(truth[i, -1]))))
    clips = [np.concatenate([truth[i, prefix - 1 : prefix], one.positions_w_m]) for i, one in enumerate(made)]
    return {
        "target_error_m": float(np.median([e for slot in LIMBS for e in error.get(slot, [])])),
        "target_error_by_joint_m": {slot: float(np.median(found)) for slot, found in error.items()},
        "heading_error_deg": float(np.degrees(np.median(turn))),
        "plans": {"windows": windows, **quality(clips), "ground_truth": quality([t[prefix - 1 :] for t in truth])},
    }
