"""How well a tracker follows clips: success, errors, falls, by behaviour (DESIGN 8, `eval tracker`)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from shared.errors import InvalidInputError
from shared.protocol.rates import TICK_HZ
from shared.statistics import wilson
from tracker_service.training.dataset import ReferenceSet
from tracker_service.training.env import TrackingEnv
from tracker_service.training.env_settings import EnvSettings

F32 = npt.NDArray[np.float32]

SUCCESS_M = 0.5
"""A clip succeeds when no joint is ever farther from the reference than this (REFERENCE 2)."""
MAX_TICKS = 300
"""Takes longer than 10 s are cut."""
GROUPS = {
    "common": ("walk", "run", "turn", "wave", "stand", "jump", "gesture"),
    "harder": ("squat", "sneak", "dance", "punch", "kick", "pick_up", "step_back", "step_side"),
}
"""Behaviours that are also judged together."""


def evaluate(
    env_settings: EnvSettings, references: ReferenceSet, human: Any, policy: Callable[[F32], F32], batch: int = 128,
    which: npt.NDArray[np.int64] | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Follow every clip, or those of numbers `which`, once from its start, without noise, until it ends or fails.

    Args:
        policy: observations (B, D) -> actions (B, H).

    Returns:
        clips, success, its ci95 (Wilson), mpjpe_mm, velocity_error_mps, falls_per_min, by_behaviour {id: {clips,
        success, ci95, mpjpe_mm}}, by_group {of GROUPS: the same}, per_clip [{name, behaviour, success, mpjpe_mm, max_m,
        seconds}].
    """
    followed = np.arange(len(references)) if which is None else which
    if len(followed) == 0:
        raise InvalidInputError("no clips to evaluate", field="clips", allowed="at least one clip")
    rows: list[dict[str, Any]] = []
    for first in range(0, len(followed), batch):
        rows += _follow(env_settings, references, human, policy, followed[first : first + batch])
    seconds = sum(row["seconds"] for row in rows)
    return {
        **_summary(rows),
        "velocity_error_mps": float(np.average([row["velocity_error_mps"] for row in rows])),
        "falls_per_min": 60.0 * sum(row["fell"] for row in rows) / max(seconds, 1e-9),
        "by_behaviour": {
            str(name): _summary([row for row in rows if row["behaviour"] == name])
            for name in np.unique(references.behaviours[followed])
        },
        "by_group": {
            group: _summary(members)
            for group, behaviours in GROUPS.items()
            if (members := [row for row in rows if row["behaviour"] in behaviours])
        },
        "per_clip": rows,
    }


def _summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    return {
        "clips": len(rows),
        "ci95": [round(v, 4) for v in wilson(sum(row["success"] for row in rows), len(rows))],
        "success": float(np.mean([row["success"] for row in rows])),
        "mpjpe_mm": float(np.mean([row["mpjpe_mm"] for row in rows])),
    }


def _follow(
    settings: EnvSettings,
    references: ReferenceSet,
    human: Any,
    policy: Callable[[F32], F32],
    clips: npt.NDArray[np.int64],
) -> list[dict[str, Any]]:
    env = TrackingEnv(human, references, settings.model_copy(update={"envs": len(clips)}), seed=0)
    head = human.skeleton.index("head")
    low_head = 0.5 * float(human.skeleton.rest_positions_m[head, 2])
    ticks = np.minimum(references.length[clips], MAX_TICKS) - 1
    error = np.zeros(len(clips))
    velocity = np.zeros(len(clips))
    worst = np.zeros(len(clips))
    counted = np.zeros(len(clips))
    alive = np.ones(len(clips), dtype=bool)
    fell = np.zeros(len(clips), dtype=bool)
    observation = env.start_at(clips)
    for tick in range(int(ticks.max())):
        distance, _, exploded = env.advance(policy(observation))
        now = alive & (tick < ticks)
        frames = env.references.start[clips] + np.minimum(env.time, references.length[clips] - 1)
        difference = env.bodies().linvel_w_mps - references.linvel_w_mps[frames]
        error[now] += distance.mean(axis=-1)[now]
        velocity[now] += np.linalg.norm(difference, axis=-1).mean(axis=-1)[now]
        worst[now] = np.maximum(worst[now], distance.max(axis=-1)[now])
        worst[now & exploded] = np.inf
        counted[now] += 1
        down = (env.bodies().pos_w_m[:, head, 2] < low_head) & (references.pos_w_m[frames, head, 2] > 1.2 * low_head)
        fell |= now & down
        # A failed clip is followed on until it has clearly fallen or recovered, but no longer measured.
        alive &= worst <= SUCCESS_M
        observation = env.observe()
    fell |= ~alive & (env.bodies().pos_w_m[:, head, 2] < low_head)
    env.close()
    return [
        {
            "name": str(references.names[clip]),
            "behaviour": str(references.behaviours[clip]),
            "success": bool(worst[i] <= SUCCESS_M),
            "mpjpe_mm": float(1e3 * error[i] / counted[i]),
            "velocity_error_mps": float(velocity[i] / counted[i]),
            "max_m": float(min(worst[i], 99.0)),
            "fell": bool(fell[i]),
            "seconds": float(counted[i] / TICK_HZ),
        }
        for i, clip in enumerate(clips)
    ]
