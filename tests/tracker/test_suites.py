"""The suites measure what they say: an impulse is an impulse, trembling shows, a push too many fells."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from shared.errors import InvalidInputError
from shared.motion.ik import standing_clip
from tracker_service.policy.learned import WEIGHTS
from tracker_service.simulation.character_spec import character
from tracker_service.simulation.humanoid import humanoid
from tracker_service.training import suites
from tracker_service.training.dataset import MotionInput, prepare
from tracker_service.training.env import TrackingEnv
from tracker_service.training.env_settings import EnvSettings
from tracker_service.training.knocks import push
from tracker_service.training.policies import policy_of

HUMAN = humanoid(character("human"))


def test_a_push_gives_the_whole_body_its_momentum() -> None:
    references = prepare(HUMAN, [MotionInput("a", "stand", 1.0, standing_clip(60, 30.0).positions_w_m)])
    env = TrackingEnv(HUMAN, references, EnvSettings(envs=2), seed=0)
    env.start_at(np.zeros(2, dtype=np.int64))
    before = env.qvel.copy()
    push(env, np.array([1]), np.array([[12.0, -5.0, 3.0]]))
    np.testing.assert_array_equal(env.qvel[0], before[0])
    data = mujoco.MjData(env.model)
    data.qpos[:47], data.qvel[:46] = env.qpos[1], env.qvel[1] - before[1]
    mujoco.mj_forward(env.model, data)
    mujoco.mj_subtreeVel(env.model, data)
    body = env.model.body("pelvis").id
    momentum = data.subtree_linvel[body] * env.model.body_subtreemass[body]
    # Armature is inertia that belongs to no body: the servos keep a little of it.
    np.testing.assert_allclose(momentum, [12.0, -5.0, 3.0], atol=0.15)
    env.close()


def test_training_knocks_limbs_and_says_whom(monkeypatch: pytest.MonkeyPatch) -> None:
    references = prepare(HUMAN, [MotionInput("a", "stand", 1.0, standing_clip(60, 30.0).positions_w_m)])
    quiet = {"push_chance": 0.0, "jump_chance": 0.0, "noise_hinge_rad": 0.0, "noise_root_m": 0.0, "noise_rate": 0.0}
    env = TrackingEnv(HUMAN, references, EnvSettings(envs=30, knock_chance=0.5, **quiet), seed=0)
    env.reset_all()
    before = env.qvel.copy()
    knocked = env._disturb()
    assert 5 < len(knocked) < 25
    changed = np.flatnonzero(np.abs(env.qvel - before).max(axis=1) > 1e-9)
    np.testing.assert_array_equal(changed, knocked)
    # What is remembered of the bodies is what they are.
    fresh = env.kinematics.states(env.qpos, env.qvel)
    np.testing.assert_allclose(env.bodies().linvel_w_mps, fresh.linvel_w_mps, atol=1e-9)
    env.close()


def test_jitter_is_the_acceleration_of_a_sine() -> None:
    t = np.arange(3000) / 30.0
    motion = np.zeros((3000, 1, 3))
    motion[:, 0, 0] = 0.01 * np.sin(2 * np.pi * 2.0 * t)
    expected = 0.01 * (2 * np.pi * 2.0) ** 2 / np.sqrt(2)
    assert suites.jitter_mps2(motion) == pytest.approx(expected, rel=0.03)


def test_standing_and_pushes_of_the_shipped_policy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(suites, "STAND_S", 6.0)
    monkeypatch.setattr(suites, "DIRECTIONS", 4)
    monkeypatch.setattr(suites, "PUSHES_NS", (10.0, 400.0))
    settings, policy = policy_of(HUMAN, WEIGHTS)
    still = suites.run_suite("stand", HUMAN, settings, policy, None)
    assert not still["fell"] and 0.0 < still["drift_m"] < 0.1 and still["jitter_mps2"] > 0.0
    pushed = suites.run_suite("pushes", HUMAN, settings, policy, None)
    assert pushed["standing"]["10_ns"] == {"n": 4, "survived": 1.0}
    assert pushed["standing"]["400_ns"]["survived"] == 0.0
    with pytest.raises(InvalidInputError, match="seat"):
        suites.run_suite("seats", HUMAN, settings, policy, None)
    with pytest.raises(InvalidInputError, match="unknown suite"):
        suites.run_suite("tea", HUMAN, settings, policy, None)
