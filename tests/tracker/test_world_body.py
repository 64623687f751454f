"""The body in torch is the body in numpy, and its mirror image is a body too."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
import torch

from tracker_service.simulation.character_spec import character
from tracker_service.simulation.humanoid import humanoid
from tracker_service.simulation.kinematics import BodyKinematics
from tracker_service.training.world.body import Kinematics, Mirror, State, rotation_of, tensor

HUMAN = humanoid(character("human"))
H = len(HUMAN.hinges)
Array = npt.NDArray[np.float64]


def random_state(count: int = 32, seed: int = 0) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    qpos = rng.normal(size=(count, 7 + H)) * 0.6
    qpos[:, 3:7] /= np.linalg.norm(qpos[:, 3:7], axis=1, keepdims=True)
    return qpos, rng.normal(size=(count, 6 + H))


def test_forward_kinematics_equal_numpys() -> None:
    qpos, qvel = random_state()
    expected = BodyKinematics(HUMAN).states(qpos, qvel)
    got = Kinematics(HUMAN)(State.of(tensor(qpos), tensor(qvel)))
    np.testing.assert_allclose(got.pos_w_m, expected.pos_w_m, atol=1e-5)
    np.testing.assert_allclose(got.rot_w, expected.rot_w, atol=1e-5)
    np.testing.assert_allclose(got.linvel_w_mps, expected.linvel_w_mps, atol=1e-4)


def test_gradient_of_a_hand_by_a_hinge_is_its_finite_difference() -> None:
    qpos, qvel = random_state(1)
    kinematics = Kinematics(HUMAN)
    state = State.of(tensor(qpos), tensor(qvel))
    hinge = HUMAN.hinges.names.index("left_shoulder_0")
    wrist = HUMAN.skeleton.index("left_wrist")
    angles = state.hinge_rad.clone().requires_grad_(True)
    moved = State(state.pos_w_m, state.rot_w, angles, *state.parts()[3:])
    kinematics(moved).pos_w_m[0, wrist, 2].backward()  # type: ignore[no-untyped-call]
    step = 1e-3
    above, below = qpos.copy(), qpos.copy()
    above[0, 7 + hinge] += step
    below[0, 7 + hinge] -= step
    numpys = BodyKinematics(HUMAN)
    slope = (numpys.poses(above)[0] - numpys.poses(below)[0])[0, wrist, 2] / (2 * step)
    assert angles.grad is not None
    assert float(angles.grad[0, hinge]) == pytest.approx(float(slope), abs=1e-4)
    assert abs(slope) > 1e-3


def test_mirroring_commutes_with_kinematics_and_undoes_itself() -> None:
    qpos, qvel = random_state()
    state, mirror, kinematics = State.of(tensor(qpos), tensor(qvel)), Mirror(HUMAN), Kinematics(HUMAN)
    flip = torch.tensor([1.0, -1.0, 1.0])
    here, there = kinematics(state), kinematics(mirror.state(state))
    torch.testing.assert_close(there.pos_w_m, (here.pos_w_m * flip)[:, mirror.joints], atol=1e-5, rtol=0)
    torch.testing.assert_close(there.linvel_w_mps, (here.linvel_w_mps * flip)[:, mirror.joints], atol=1e-4, rtol=0)
    for a, b in zip(mirror.state(mirror.state(state)).parts(), state.parts(), strict=True):
        torch.testing.assert_close(a, b)
    which = torch.arange(len(qpos)) % 2 == 0
    some = mirror.some(state, which)
    torch.testing.assert_close(some.hinge_rad[1], state.hinge_rad[1])
    torch.testing.assert_close(some.hinge_rad[0], mirror.hinge(state.hinge_rad)[0])


def test_rotation_vector_gives_the_rotation_about_it() -> None:
    turned = rotation_of(torch.tensor([[0.0, 0.0, np.pi / 2], [0.0, 0.0, 0.0]]))
    expected = torch.tensor([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    torch.testing.assert_close(turned[0], expected, atol=1e-6, rtol=0)
    torch.testing.assert_close(turned[1], torch.eye(3), atol=1e-6, rtol=0)
