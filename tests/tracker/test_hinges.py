"""Hinge angles and rotations are each other's inverse, continuous, and what MuJoCo makes of them."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shared.motion.ik import rotations_from_positions
from shared.motion.kinematics import forward_kinematics
from shared.motion.rotations import matrix_from_axis_angle, quat_from_matrix
from shared.motion.skeleton import CANONICAL
from tracker_service.simulation.character_spec import HUMAN
from tracker_service.simulation.humanoid import body_ids, humanoid, humanoid_model
from tracker_service.simulation.kinematics import BodyKinematics, qvel_from_qpos

HUMANOID = humanoid(HUMAN)
HINGES = HUMANOID.hinges


def local_rotations(q: np.ndarray) -> np.ndarray:
    out = np.broadcast_to(np.eye(3), (len(q), len(CANONICAL), 3, 3)).copy()
    out[:, 1:] = HINGES.rotations(q)
    return out


def test_forty_hinges_and_orthonormal_triples() -> None:
    assert len(HINGES) == 40
    for spec in HINGES.specs:
        np.testing.assert_allclose(spec.axes.T @ spec.axes, np.eye(3), atol=1e-12)
        assert np.linalg.det(spec.axes) == pytest.approx(1.0)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_angles_invert_rotations(seed: int) -> None:
    rng = np.random.default_rng(seed)
    walk = np.cumsum(rng.normal(size=(40, len(HINGES))) * 0.05, axis=0)
    q = np.clip(walk, HINGES.lower, HINGES.upper)
    np.testing.assert_allclose(HINGES.angles(local_rotations(q)), q, atol=1e-9)


def test_positive_knee_bends_back_and_elbows_bend_forward() -> None:
    for hinge, joint, end, direction in (
        ("left_knee_0", "left_knee", "left_ankle", -1.0),
        ("right_knee_0", "right_knee", "right_ankle", -1.0),
    ):
        q = np.zeros((1, len(HINGES)))
        q[0, HINGES.names.index(hinge)] = 1.0
        pos, _ = forward_kinematics(CANONICAL, np.zeros((1, 3)), local_rotations(q))
        gap = pos[0, CANONICAL.index(end)] - pos[0, CANONICAL.index(joint)]
        assert gap[0] * direction > 0.3
    for side in ("left", "right"):
        q = np.zeros((1, len(HINGES)))
        q[0, HINGES.names.index(f"{side}_elbow_0")] = 1.0
        pos, _ = forward_kinematics(CANONICAL, np.zeros((1, 3)), local_rotations(q))
        gap = pos[0, CANONICAL.index(f"{side}_wrist")] - pos[0, CANONICAL.index(f"{side}_elbow")]
        assert gap[2] < 0 or gap[0] > 0.1  # the arm hangs at zero shoulder angles


def test_mirrored_motion_has_the_same_angles() -> None:
    rng = np.random.default_rng(3)
    q = rng.uniform(HINGES.lower, HINGES.upper, size=(20, len(HINGES))) * 0.5
    pos, _ = forward_kinematics(CANONICAL, np.zeros((20, 3)), local_rotations(q))
    other = np.array(
        [
            HINGES.names.index(n.replace("left", "x").replace("right", "left").replace("x", "right"))
            for n in HINGES.names
        ]
    )
    middle = np.array(["left" not in n and "right" not in n for n in HINGES.names])
    mirrored = np.where(middle & (HINGES.slot_of > 0), -q, q[:, other])
    flipped, _ = forward_kinematics(CANONICAL, np.zeros((20, 3)), local_rotations(mirrored))
    np.testing.assert_allclose(flipped, (pos * [1, -1, 1])[:, CANONICAL.mirror_map], atol=1e-9)


def test_angles_do_not_jump_where_the_arm_passes_a_pole() -> None:
    t = np.linspace(0, 2 * np.pi, 120)
    angles = np.stack([2.0 * np.sin(t), 1.45 * np.cos(2 * t), 0.5 * np.sin(3 * t)], axis=-1)
    q = np.zeros((len(t), len(HINGES)))
    for slot in range(3):
        q[:, HINGES.names.index(f"left_shoulder_{slot}")] = angles[:, slot]
    found = HINGES.angles(local_rotations(q))
    assert np.abs(np.diff(found, axis=0)).max() < 1.2 * np.abs(np.diff(q, axis=0)).max() + 1e-9


def test_batched_kinematics_equal_mujoco() -> None:
    model = humanoid_model(HUMANOID)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    q = np.concatenate([[0.3, -0.2, 1.0], rng.normal(size=4), rng.uniform(HINGES.lower, HINGES.upper)])
    q[3:7] /= np.linalg.norm(q[3:7])
    v = rng.normal(size=model.nv)
    data.qpos[:], data.qvel[:] = q, v
    mujoco.mj_forward(model, data)
    states = BodyKinematics(HUMANOID).states(q[None], v[None])
    ids = body_ids(model, CANONICAL)
    np.testing.assert_allclose(states.pos_w_m[0], data.xpos[ids], atol=1e-12)
    np.testing.assert_allclose(states.rot_w[0].reshape(-1, 9), data.xmat[ids], atol=1e-12)
    for joint, body in enumerate(ids):
        velocity = np.zeros(6)
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body, velocity, 0)
        np.testing.assert_allclose(states.angvel_w_radps[0, joint], velocity[:3], atol=1e-9)
        np.testing.assert_allclose(states.linvel_w_mps[0, joint], velocity[3:], atol=1e-9)


def test_velocity_of_a_steady_turn() -> None:
    rate, spin = 30.0, 1.7
    t = np.arange(20) / rate
    turn = quat_from_matrix(matrix_from_axis_angle(np.tile([0.0, 0.0, 1.0], (20, 1)), spin * t))
    q = np.zeros((20, 7 + len(HINGES)))
    q[:, 0] = 0.5 * t
    q[:, 3:7] = turn
    q[:, 7] = 2.0 * t
    v = qvel_from_qpos(q, rate)
    np.testing.assert_allclose(v[:, 0], 0.5, atol=1e-9)
    np.testing.assert_allclose(v[:, 5], spin, atol=1e-9)
    np.testing.assert_allclose(v[:, 6], 2.0, atol=1e-9)


def test_hinges_of_ik_rebuild_the_positions() -> None:
    rng = np.random.default_rng(1)
    walk = np.cumsum(rng.normal(size=(60, len(HINGES))) * 0.02, axis=0)
    bend = {"left_knee_0": 1.2, "right_knee_0": 1.2, "left_elbow_0": 1.3, "right_elbow_0": 1.3}
    for name, angle in bend.items():
        walk[:, HINGES.names.index(name)] += angle
    q = np.clip(walk, HINGES.lower, HINGES.upper)
    pos, _ = forward_kinematics(CANONICAL, np.tile([0, 0, 1.0], (60, 1)), local_rotations(q))
    local = rotations_from_positions(pos)
    again = local.copy()
    again[:, 1:] = HINGES.rotations(HINGES.angles(local))
    rebuilt, _ = forward_kinematics(CANONICAL, pos[:, 0], again)
    assert np.linalg.norm(rebuilt - pos, axis=-1).max() < 0.01
