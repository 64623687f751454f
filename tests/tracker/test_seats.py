"""Seats in training: a block that carries, at its own height in each environment, and is seen alike everywhere."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from shared.motion.ik import standing_clip
from tracker_service.simulation.character_spec import character
from tracker_service.simulation.humanoid import humanoid
from tracker_service.training.dataset import MotionInput, ReferenceSet, load_bank, prepare
from tracker_service.training.env import TrackingEnv
from tracker_service.training.env_settings import EnvSettings
from tracker_service.training.main import with_sofas
from tracker_service.training.seats import HEIGHTS, NO_SEAT, height_points, seat_heights
from tracker_service.training.world.body import Kinematics, Mirror, State, tensor
from tracker_service.training.world.sight import support_heights

HUMAN = humanoid(character("human"))
FEET = (HUMAN.skeleton.index("left_foot"), HUMAN.skeleton.index("right_foot"))
HIGH, LOW = (-0.1, 0.05, 0.45, 0.4, 0.0), (-0.1, 0.0, 0.25, 0.0, 0.0)
SOFA = (-0.1, 0.0, 0.35, 0.4, 1.0)


@pytest.fixture(scope="module")
def references() -> ReferenceSet:
    stand = standing_clip(60, 30.0).positions_w_m
    seats = {"high": HIGH, "low": LOW, "sofa": SOFA}
    return prepare(HUMAN, [MotionInput(n, "sit", 1.0, stand, s) for n, s in seats.items()] + [
        MotionInput("none", "stand", 1.0, stand)
    ])  # fmt: skip


def test_limp_bodies_come_to_rest_on_their_own_seats(references: ReferenceSet) -> None:
    env = TrackingEnv(HUMAN, references, EnvSettings(envs=4, heights=True), seed=0)
    env.start_at(np.arange(4))
    squat = np.zeros((4, env.hinges), np.float32)
    # Hips and knees folded in the air over the seats: the body falls on what is below it.
    for name, angle in (("hip_0", -1.5), ("knee_0", 1.5)):
        for side in ("left_", "right_"):
            hinge = HUMAN.hinges.names.index(side + name)
            env.state[:, 1 + 7 + hinge] = angle
            squat[:, hinge] = angle
    env.state[:, 3] = 0.75
    env.moved()
    env.references = replace(references, qpos=np.repeat(env.qpos.astype(np.float32)[:1], len(references.qpos), 0))
    lowest = []
    for _ in range(20):
        env.advance(np.zeros((4, env.hinges), np.float32))
        lowest.append(env.bodies().pos_w_m[:, 0, 2].copy())
    high, low, sofa, floor = np.min(lowest, axis=0)
    top = references.seat[0, 2]
    assert top + 0.05 < high < top + 0.2
    assert LOW[2] + 0.05 < low < high - 0.1
    assert references.seat[2, 2] + 0.05 < sofa < references.seat[2, 2] + 0.2
    assert floor < low - 0.1
    env.close()


def test_heights_are_the_seats_top_below_the_pelvis_only(references: ReferenceSet) -> None:
    env = TrackingEnv(HUMAN, references, EnvSettings(envs=4, heights=True), seed=0)
    seen = env.start_at(np.arange(4))[:, -HEIGHTS:]
    assert seen[0, -1] == np.float32(references.seat[0, 2]) and seen[1, -1] == np.float32(0.25) and not seen[3].any()
    assert not seen[0, 8]  # 0.4 m ahead and to the left is beyond the seat's edge
    # Beside where one sits there is more of a sofa.
    assert seen[2, 3] == np.float32(0.35) and not seen[0, 3] and not seen[1, 3]
    bodies = env.bodies()
    points = height_points(bodies.pos_w_m, bodies.rot_w[:, 0, :, 0], FEET)
    assert not seat_heights(points, np.full(4, 0.2), references.seat).any()  # a body below the seat
    env.close()


def test_torch_and_its_mirror_see_the_same(references: ReferenceSet) -> None:
    env = TrackingEnv(HUMAN, references, EnvSettings(envs=4, heights=True), seed=0)
    env.start_at(np.arange(4))
    env.state[:, 1:3] += np.array([[0.1, 0.05], [-0.2, 0.1], [-0.1, 0.2], [0.0, 0.0]])
    env.moved()
    state, seat = State.of(tensor(env.qpos), tensor(env.qvel)), tensor(references.seat)
    heights = support_heights(Kinematics(HUMAN)(state), seat, FEET)
    np.testing.assert_allclose(heights, env.observe()[:, -HEIGHTS:], atol=1e-6)
    mirror, everyone = Mirror(HUMAN), torch.ones(4, dtype=torch.bool)
    other = support_heights(Kinematics(HUMAN)(mirror.state(state)), mirror.some_seats(seat, everyone), FEET)
    grid = other[:, :9].view(4, 3, 3).flip(2).flatten(1)
    torch.testing.assert_close(torch.cat([grid, other[:, [10, 9, 11]]], 1), heights)
    assert heights[:3].any(dim=1).all()
    env.close()


def test_a_seat_is_lowered_until_who_sits_is_not_in_it() -> None:
    stand = standing_clip(40, 30.0).positions_w_m
    # A seat whose top is well above the lowest point of the pelvis, and one out of reach below.
    deep, free = (0.0, 0.0, 0.90, 0.0, 0.0), (0.0, 0.0, 0.30, 0.0, 1.0)
    made = prepare(HUMAN, [MotionInput("deep", "sit", 1.0, stand, deep), MotionInput("free", "sit", 1.0, stand, free)])
    assert 0.3 < made.seat[0, 2] < 0.9 - 0.02
    np.testing.assert_allclose(made.seat[1], free)
    env = TrackingEnv(HUMAN, made, EnvSettings(envs=2, heights=True), seed=0)
    env.start_at(np.arange(2))
    assert env.observe()[0, -1] == np.float32(made.seat[0, 2])
    env.close()


def test_a_bank_of_plans_brings_its_seats_as_they_are(tmp_path: Path) -> None:
    stand = standing_clip(80, 30.0).positions_w_m.astype(np.float32)
    deep = np.array([0.0, 0.0, 0.90, 0.0, 1.0], dtype=np.float32)
    np.savez(tmp_path / "get_up_1.npz", positions_w_m=stand, seat=deep)
    np.savez(tmp_path / "plan_1.npz", positions_w_m=stand)
    made = prepare(HUMAN, load_bank(tmp_path))
    np.testing.assert_allclose(made.seat, [deep, NO_SEAT], atol=1e-6)


def test_every_second_seat_that_can_be_is_a_sofa(references: ReferenceSet) -> None:
    assert not with_sofas(references, HUMAN)[[0, 1, 3], 4].any()  # they stand in it
    before = references.seat + np.where(references.seat[:, 2:3] > 0, [-0.6, 0.0, 0.0, 0.0, 0.0], 0.0)
    np.testing.assert_array_equal(with_sofas(replace(references, seat=before), HUMAN)[:, 4], [1.0, 0.0, 1.0, 0.0])
