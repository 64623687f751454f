"""Impulses on bodies in training's environments, and the walks in which they come."""

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt

from shared.data.corpus import Corpus
from shared.errors import InvalidInputError
from tracker_service.training.dataset import MotionInput
from tracker_service.training.env import TrackingEnv

Floats = npt.NDArray[np.float64]

WALKS = 4


def push(env: TrackingEnv, rows: npt.NDArray[np.int64], impulse_w_ns: Floats) -> None:
    """Change velocities of some environments as an impulse (N, 3) at the pelvis' centre of mass does."""
    model, data = env.model, mujoco.MjData(env.model)
    body = model.body("pelvis").id
    nq, nv = model.nq, model.nv
    for row, impulse in zip(rows, impulse_w_ns, strict=True):
        data.qpos[:] = env.state[row, 1 : 1 + nq]
        data.qvel[:] = env.state[row, 1 + nq : 1 + nq + nv]
        mujoco.mj_forward(model, data)
        force, change = np.zeros((1, nv)), np.zeros((1, nv))
        mujoco.mj_applyFT(model, data, impulse, np.zeros(3), data.xipos[body], body, force[0])
        mujoco.mj_solveM(model, data, change, force)
        env.state[row, 1 + nq : 1 + nq + nv] += change[0]
    env.moved()


def long_walks(corpus: Corpus, ticks: int) -> list[MotionInput]:
    """The first few held-out recordings of straight walking that are long enough."""
    found = [
        MotionInput(clip.name, clip.behaviour, 1.0, corpus.positions(i))
        for i, clip in enumerate(corpus.clips)
        if clip.split == "heldout" and clip.action in ("walk", "walk_fast", "walk_slow") and clip.frames >= ticks
    ]
    if not found:
        raise InvalidInputError("the corpus holds out no straight walk that is long enough", field="corpus")
    return found[:WALKS]
