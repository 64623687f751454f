"""How well plans keep keyframes and velocities that held-out windows did themselves; only what the weights take."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from planner_service.training.dataset import Material, WindowSampler
from planner_service.training.windows import window_positions
from shared.motion.skeleton import CANONICAL
from shared.plugins.interfaces import Planner
from shared.protocol.messages import TICK_HZ, Plan, PlanRequest
from shared.protocol.rates import PLANNER_FPS as FPS

Array = npt.NDArray[np.float64]

KEYED = ("all", "pelvis", "left_wrist", "right_wrist", "left_foot", "right_foot", "head")
"""What windows are keyed with, in turn."""
FIRST_KEY_S = 0.5
BATCH = 16


def conditions(planner: Planner, material: Material, windows: int, seed: int) -> dict[str, object]:
    """Medians over single plans that continue held-out windows, with their text and one condition of the window's own.

    Returns:
        `keyframe_error_m`: distance of keyed joints from one key 0.5 s ahead to the plan's end, a number a window (the
        mean over its joints), also by what is keyed; `velocity_error_mps`: how far the mean velocity of the plan's
        second half is from the one asked for. Only those that the planner takes.
    """
    prefix, frames = planner.spec.prefix_frames, planner.spec.plan_frames
    batch = WindowSampler(material, prefix, frames, seed, augment=False).draw(windows)
    truth = window_positions(batch.features.numpy())
    texts = [material.sentences[row] for row in batch.sentence]
    bare = [
        PlanRequest(
            start_tick=0,
            prefix_positions_w_m=truth[i, :prefix],
            prefix_rotations_6d=np.zeros((prefix, 22, 6)),
            prefix_velocities_w_mps=np.zeros((prefix, 22, 3)),
            text=texts[i],
            horizon_frames=frames,
            seed=seed + i,
        )
        for i in range(windows)
    ]
    out: dict[str, object] = {}
    if "keyframes" in planner.spec.conditions:
        out |= _keyframes(planner, bare, truth[:, prefix:], seed)
    if "velocity" in planner.spec.conditions:
        out |= _velocity(planner, bare, truth[:, prefix:])
    return out


def _keyframes(planner: Planner, bare: list[PlanRequest], truth: Array, seed: int) -> dict[str, object]:
    rng, frames = np.random.default_rng(seed), truth.shape[1]
    # Every second frame, which is where whole ticks are.
    due = rng.integers(round(FIRST_KEY_S * FPS / 2), frames // 2 + 1, len(bare)) * 2
    requests, masks = [], []
    for i, request in enumerate(bare):
        name = KEYED[i % len(KEYED)]
        mask = np.array([name in ("all", joint) for joint in CANONICAL.names])
        masks.append(mask)
        key = {
            "keyframe_ticks": np.array([due[i] * TICK_HZ // FPS]),
            "keyframe_mask": mask[None].astype(np.uint8),
            "keyframe_positions_w_m": truth[i, due[i] - 1][None],
        }
        requests.append(PlanRequest.model_validate({**dict(request), **key, **_NO_TURNS}))
    error: dict[str, list[float]] = {}
    for i, plan in enumerate(_plans(planner, requests)):
        gap = np.linalg.norm(plan.positions_w_m[due[i] - 1] - truth[i, due[i] - 1], axis=-1)
        error.setdefault(KEYED[i % len(KEYED)], []).append(float(gap[masks[i]].mean()))
    every = [gap for found in error.values() for gap in found]
    return {
        "keyframe_error_m": float(np.median(every)),
        "keyframe_error_by_joint_m": {name: float(np.median(found)) for name, found in error.items()},
    }


_NO_TURNS = {"keyframe_rotation_mask": np.zeros((1, 22), np.uint8), "keyframe_rotations_6d": np.zeros((1, 22, 6))}


def _velocity(planner: Planner, bare: list[PlanRequest], truth: Array) -> dict[str, object]:
    wanted = _late_velocity(truth)
    requests = [
        request.model_copy(update={"desired_velocity_w_mps": (float(v[0]), float(v[1]))})
        for request, v in zip(bare, wanted, strict=True)
    ]
    made = _late_velocity(np.stack([plan.positions_w_m for plan in _plans(planner, requests)]))
    return {"velocity_error_mps": float(np.median(np.linalg.norm(made - wanted, axis=-1)))}


def _late_velocity(positions_w_m: Array) -> Array:
    """(B, 2) mean horizontal velocity of the root over the second half of plans (B, N, 22, 3)."""
    frames = positions_w_m.shape[1]
    way: Array = positions_w_m[:, -1, 0, :2] - positions_w_m[:, frames // 2 - 1, 0, :2]
    return way * (FPS / (frames - frames // 2))


def _plans(planner: Planner, requests: list[PlanRequest]) -> list[Plan]:
    return [plan for at in range(0, len(requests), BATCH) for plan in planner.plan(requests[at : at + BATCH])]
