"""Impulses on bodies in training's environments, and the walks in which they come."""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco
import numpy as np
import numpy.typing as npt

from shared.data.corpus import Corpus
from shared.errors import InvalidInputError
from tracker_service.training.dataset import MotionInput

if TYPE_CHECKING:
    from tracker_service.training.env import TrackingEnv

Floats = npt.NDArray[np.float64]

WALKS = 4


class Knocks:
    """Velocity changes that impulses on bodies of a model make."""

    def __init__(self, model: mujoco.MjModel):
        self._model, self._data = model, mujoco.MjData(model)

    def change(self, qpos: Floats, qvel: Floats, body: int, impulse_w_ns: Floats) -> Floats:
        """(V,) change of qvel by an impulse (3,) at the centre of mass of a body of the humanoid, by its MuJoCo id."""
        model, data = self._model, self._data
        data.qpos[: len(qpos)], data.qvel[: len(qvel)] = qpos, qvel
        mujoco.mj_forward(model, data)
        force, change = np.zeros((1, model.nv)), np.zeros((1, model.nv))
        mujoco.mj_applyFT(model, data, impulse_w_ns, np.zeros(3), data.xipos[body], body, force[0])
        mujoco.mj_solveM(model, data, change, force)
        return np.asarray(change[0, : len(qvel)])


def push(env: TrackingEnv, rows: npt.NDArray[np.int64], impulse_w_ns: Floats) -> None:
    """Change velocities of some environments as an impulse (N, 3) at the pelvis' centre of mass does."""
    knocks, body = Knocks(env.model), env.model.body("pelvis").id
    for row, impulse in zip(rows, impulse_w_ns, strict=True):
        env.add_velocity(int(row), knocks.change(env.qpos[row], env.qvel[row], body, impulse))
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
