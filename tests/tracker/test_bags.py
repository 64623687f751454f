"""The bag in training: it takes a person's blow to topple it, stands where its clip has it, and nobody begins in it."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from shared.motion.ik import standing_clip
from tracker_service.simulation.character_spec import character
from tracker_service.simulation.humanoid import humanoid
from tracker_service.training.bags import NO_BAG, last_clear, lean_of
from tracker_service.training.dataset import PLAN, MotionInput, load_bank, prepare
from tracker_service.training.env import TrackingEnv
from tracker_service.training.env_settings import EnvSettings
from tracker_service.training.seats import NO_SEAT, mocap_of, training_model

HUMAN = humanoid(character("human"))
BLOW_S = 0.05


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return training_model(HUMAN)


def placed(model: mujoco.MjModel, bag: tuple[float, ...]) -> mujoco.MjData:
    data = mujoco.MjData(model)
    place = mocap_of(np.array([NO_SEAT]), np.array([bag]))[0]
    data.mocap_pos[:], data.mocap_quat[:] = place[:9].reshape(3, 3), place[9:].reshape(3, 4)
    data.qpos[-2:] = bag[3:]
    return data


def leant_deg(model: mujoco.MjModel, impulse_ns: float, height_m: float) -> float:
    data, body = placed(model, (2.0, 0.0, 0.0, 0.0, 0.0)), model.body("bag").id
    force = np.array([impulse_ns / BLOW_S, 0.0, 0.0])
    for step in range(round(2.0 / model.opt.timestep)):
        data.xfrc_applied[body] = 0.0
        if step * model.opt.timestep < BLOW_S:
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            data.xfrc_applied[body, :3] = force
            data.xfrc_applied[body, 3:] = np.cross([2.0, 0.0, height_m] - data.xipos[body], force)
        mujoco.mj_step(model, data)
    return float(np.degrees(data.qpos[-1]))


def test_it_takes_the_blow_that_topples_the_real_bag(model: mujoco.MjModel) -> None:
    # docs/scenes.md: 42 N s at 1.3 m; the same blow lower down topples nothing.
    assert 1.0 < leant_deg(model, 33.0, 1.3) < 15.0
    assert leant_deg(model, 52.0, 1.3) > 75.0
    assert leant_deg(model, 52.0, 0.7) < 15.0


def test_the_lean_gives_the_way_its_axis_points(model: mujoco.MjModel) -> None:
    for up in ([0.0, 0.0, 1.0], [0.3, 0.0, 0.95], [-0.2, 0.4, 0.9], [0.0, -0.6, 0.8]):
        axis = np.array(up) / np.linalg.norm(up)
        data = placed(model, (1.0, 2.0, 0.0, *lean_of(axis)))
        mujoco.mj_kinematics(model, data)
        np.testing.assert_allclose(data.xmat[model.body("bag").id].reshape(3, 3)[:, 2], axis, atol=1e-9)
        np.testing.assert_allclose(data.xpos[model.body("bag").id], [1.0, 2.0, 0.0], atol=1e-9)


def through(bag_x_m: float) -> MotionInput:
    """Standing that glides 1.5 m forward, through a bag if there is one."""
    stand = standing_clip(60, 30.0).positions_w_m.copy()
    stand[..., 0] += np.linspace(0.0, 1.5, 60)[:, None]
    return MotionInput("beside_1", PLAN, 1.0, stand, bag=(bag_x_m, 0.0, 0.0, 0.0, 0.02))


def test_a_bag_holds_up_who_goes_through_it_and_none_begins_in_it() -> None:
    free = through(1.0)
    made = prepare(HUMAN, [free, MotionInput("none", PLAN, 1.0, free.positions_w_m)])
    np.testing.assert_allclose(made.bag, [free.bag, NO_BAG])
    env = TrackingEnv(HUMAN, made, EnvSettings(envs=2), seed=0)
    env.start_at(np.arange(2))
    env.state[:, env.first_v] = 2.0  # gliding at 2 m/s
    env.moved()
    for _ in range(30):
        env.advance(np.zeros((2, env.hinges), np.float32))
    beside, alone = env.bodies().pos_w_m[:, 0, 0]
    assert env.state[0, 1 + 7 + env.hinges + 1] > 0.05, "it leans farther"
    assert beside < alone - 0.05
    clear = last_clear(made.pos_w_m[:60], made.bag[0])
    assert 5 < clear < 40
    env.reset_all()
    for _ in range(40):
        env._begin(np.arange(2))
        assert (env.begun[env.clip == 0] <= clear).all()
    env.close()


def test_ticks_at_a_bag_are_told_as_ones_that_do_not_follow_from_what_is_seen() -> None:
    free = through(1.0)
    made = prepare(HUMAN, [free, MotionInput("none", PLAN, 1.0, free.positions_w_m)])
    quiet = {"push_chance": 0.0, "knock_chance": 0.0, "jump_chance": 0.0, "stop_mean_m": 9.0, "stop_max_m": 9.0}
    env = TrackingEnv(HUMAN, made, EnvSettings(envs=2, **quiet), seed=0)
    env.reset_all()
    env.age[:] = 0
    env.start_at(np.arange(2))
    clear = last_clear(made.pos_w_m[:60], made.bag[0])
    told = [env.step(np.zeros((2, env.hinges), np.float32)).disturbed.tolist() for _ in range(clear + 3)]
    assert told == [[]] * (clear - 1) + [[0]] * 4
    env.close()


def test_a_bank_brings_plans_beside_a_bag_whole(tmp_path: Path) -> None:
    piece = through(1.0).positions_w_m.astype(np.float32)
    axis = np.array([np.sin(0.2), 0.0, np.cos(0.2)])
    np.savez(tmp_path / "beside_1.npz", positions_w_m=piece, bag=np.array([1.0, -0.5, *axis], dtype=np.float32))
    (motion,) = load_bank(tmp_path)
    np.testing.assert_allclose(motion.bag, (1.0, -0.5, 0.0, 0.0, 0.2), atol=1e-6)
    np.testing.assert_array_equal(motion.positions_w_m, piece)
    assert motion.seat == NO_SEAT
