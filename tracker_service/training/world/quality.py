"""How good the learned model is: how far it drifts from the simulator, whether its gradients point the right way."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
import numpy.typing as npt
import torch

from tracker_service.training.env import SUBSTEPS, TrackingEnv
from tracker_service.training.seats import CONTROL_SPEC, mocap_of
from tracker_service.training.world.body import State, tensor
from tracker_service.training.world.learner import Learner
from tracker_service.training.world.replay import Replay

Floats = npt.NDArray[np.float64]
HORIZONS = (1, 2, 4, 8, 16)
PERTURBATION_RAD = 0.02


def drift_mm(learner: Learner, replay: Replay, rng: np.random.Generator, count: int = 512) -> dict[str, float]:
    """Mean distance of all bodies from where the simulator had them, after 1 to 16 ticks under the same targets."""
    out = {}
    with torch.no_grad():
        places = replay.draw(rng, count, max(HORIZONS))
        at = learner.spots(places)
        state = learner.state_at(replay, at.later(0))
        bodies = learner.kinematics(state)
        seat = learner.seats_at(replay, places)
        for tick in range(1, max(HORIZONS) + 1):
            target = replay.target[at.later(tick - 1)]
            heights = learner.heights_of(bodies, seat)
            state = learner.model(state, bodies, target, heights)
            bodies = learner.kinematics(state)
            if tick in HORIZONS:
                true = learner.kinematics(learner.state_at(replay, at.later(tick)))
                distance = (bodies.pos_w_m - true.pos_w_m).norm(dim=-1)
                out[f"drift_mm_{tick}"] = 1e3 * float(distance.mean())
    return out


def response_cosine(
    learner: Learner, env: TrackingEnv, replay: Replay, rng: np.random.Generator, count: int = 48,
    ticks: Sequence[int] = (1, 2, 4),
) -> dict[str, float]:  # fmt: skip
    """Cosine between the model's and the simulator's response of all body positions to a servo perturbation.

    Each of `count` recorded states is played on twice in the simulator, with its recorded targets and with the targets
    of the first tick moved by a random direction of PERTURBATION_RAD a hinge; the same in the model.
    """
    last = max(ticks)
    places = replay.draw(rng, count, last)
    index, at = places.later(0), learner.spots(places)
    count = len(places.slot)
    targets = np.stack([_array(replay.target[at.later(k)]) for k in range(last)], axis=1)
    push = rng.choice([-1.0, 1.0], size=(count, env.hinges)) * PERTURBATION_RAD
    moved = targets.copy()
    moved[:, 0] += push
    seat = env.references.seat[replay.clip[index]]
    qpos, qvel = _array(replay.qpos[at.later(0)]), _array(replay.qvel[at.later(0)])
    real = [_simulated(env, qpos, qvel, t, seat) for t in (targets, moved)]
    imagined = [_imagined(learner, qpos, qvel, t, seat) for t in (targets, moved)]
    out = {}
    for tick in ticks:
        a = (real[1][:, tick - 1] - real[0][:, tick - 1]).reshape(count, -1)
        b = (imagined[1][:, tick - 1] - imagined[0][:, tick - 1]).reshape(count, -1)
        sizes = np.linalg.norm(a, axis=-1), np.linalg.norm(b, axis=-1)
        cosine = np.sum(a * b, axis=-1) / np.maximum(sizes[0] * sizes[1], 1e-12)
        out[f"response_cosine_{tick}"] = float(np.median(cosine))
        out[f"response_ratio_{tick}"] = float(np.median(sizes[1] / np.maximum(sizes[0], 1e-12)))
    return out


def _array(values: torch.Tensor) -> Floats:
    return np.asarray(values.cpu().numpy(), dtype=np.float64)


def _simulated(env: TrackingEnv, qpos: Floats, qvel: Floats, targets: Floats, seat: Floats) -> Floats:
    """Body positions (N, T, J, 3) after each tick of the simulator under targets (N, T, H)."""
    count, ticks = targets.shape[:2]
    state = np.zeros((count, mujoco.mj_stateSize(env.model, mujoco.mjtState.mjSTATE_FULLPHYSICS)))
    state[:, 1 : 1 + qpos.shape[1]] = qpos
    first = 1 + env.model.nq
    state[:, first : first + qvel.shape[1]] = qvel
    mocap = np.repeat(mocap_of(seat)[:, None], ticks, axis=1)
    control = np.repeat(np.concatenate([targets, mocap], axis=-1), SUBSTEPS, axis=1)
    states = env.roll(state, control, CONTROL_SPEC)[:, SUBSTEPS - 1 :: SUBSTEPS]
    flat = states[..., 1 : 1 + qpos.shape[1]].reshape(count * ticks, -1)
    pos, _ = env.kinematics.poses(flat)
    return np.asarray(pos, dtype=np.float64).reshape(count, ticks, -1, 3)


@torch.no_grad()
def _imagined(learner: Learner, qpos: Floats, qvel: Floats, targets: Floats, seat: Floats) -> Floats:
    """The same from the model."""
    device = learner.device
    state = State.of(tensor(qpos, device), tensor(qvel, device))
    bodies, seats = learner.kinematics(state), tensor(seat, device)
    out = []
    for tick in range(targets.shape[1]):
        state = learner.model(state, bodies, tensor(targets[:, tick], device), learner.heights_of(bodies, seats))
        bodies = learner.kinematics(state)
        out.append(_array(bodies.pos_w_m))
    return np.stack(out, axis=1)
