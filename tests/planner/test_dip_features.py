"""Features in torch and in windows agree with shared.motion.features; targets and heading are seen from one frame."""

from __future__ import annotations

import numpy as np
import torch

from planner_service.dip.conditions import TARGET_NUMBERS, TargetBatch, wrapped_difference
from planner_service.dip.features_torch import Normalizer, plan_to_positions
from planner_service.training.bending import bend, stance_pivot
from planner_service.training.disturbance import disturb
from planner_service.training.windows import rotations_of, window_features, window_positions
from shared.motion.features import (
    CONTACTS,
    JOINT_POSITIONS,
    features_to_global,
    global_to_features,
    root_state,
    to_root_frame,
)
from shared.motion.metrics import sole_points
from tests.planner.dip_helpers import moving_body


def test_torch_r2g_equals_numpy_from_the_last_prefix_frame() -> None:
    motion = moving_body(60, 20.0, 1.3, 0.8)
    features = global_to_features(motion, 20)
    positions, heading = plan_to_positions(torch.from_numpy(features[20:]), 20)
    state = root_state(motion[19])
    expected = to_root_frame(motion[20:].reshape(-1, 3), state).reshape(40, 22, 3)
    np.testing.assert_allclose(positions.numpy(), expected, atol=1e-9)
    np.testing.assert_allclose(features_to_global(features[19:], 20, state)[1:], motion[20:], atol=1e-9)
    assert heading.shape == (40,)


def test_torch_r2g_passes_gradients_to_the_root() -> None:
    features = torch.from_numpy(global_to_features(moving_body(41, 20.0), 20)[1:]).requires_grad_()
    plan_to_positions(features, 20)[0][-1, 0, 0].backward()
    assert features.grad is not None
    # The last x of the root moves by 1 / fps for each unit of forward velocity while the heading is still near zero.
    assert abs(float(features.grad[0, 1]) - 1 / 20) < 1e-6


def test_windows_are_g2r_of_each_window() -> None:
    windows = np.stack([moving_body(60, 20.0, 1.0, r, r) for r in (-0.5, 0.0, 0.7)])
    each = np.stack([global_to_features(w, 20) for w in windows])
    together = window_features(windows, rotations_of(each.astype(np.float32)))
    np.testing.assert_allclose(together, each, atol=1e-5)


def test_window_positions_start_at_the_origin() -> None:
    motion = moving_body(60, 20.0)
    back = window_positions(global_to_features(motion, 20)[None])[0]
    expected = to_root_frame(motion.reshape(-1, 3), root_state(motion[0])).reshape(60, 22, 3)
    np.testing.assert_allclose(back, expected, atol=1e-9)


def test_bending_turns_the_path_and_keeps_the_standing_foot() -> None:
    motion = np.repeat(moving_body(1, 20.0), 60, 0)
    features = global_to_features(motion, 20)[None].astype(np.float32)
    features[..., CONTACTS] = (1.0, 1.0, 0.0, 0.0)
    turn = np.full((1, 60), 0.5 / 20)
    bent = bend(features, turn)
    positions = window_positions(bent)[0]
    left = sole_points(positions)[:, :2].mean(1)
    assert np.linalg.norm(left - left[0], axis=-1).max() < 1e-4
    turned = float(plan_to_positions(torch.from_numpy(bent[:, 1:]), 20)[1][0, -1])
    assert abs(turned - 0.5 * 59 / 20) < 1e-4
    assert np.linalg.norm(positions[-1, 0, :2]) > 0.05
    again = window_features(positions[None], rotations_of(bent))
    np.testing.assert_allclose(again[0, 1:, :259], bent[0, 1:, :259], atol=1e-4)


def test_pivot_is_the_root_where_no_foot_stands() -> None:
    features = global_to_features(moving_body(60, 20.0), 20)[None].astype(np.float32)
    features[..., CONTACTS] = 0.0
    assert not stance_pivot(features).any()


def test_disturbed_windows_settle_on_the_motion() -> None:
    features = np.repeat(global_to_features(moving_body(60, 20.0), 20)[None].astype(np.float32), 8, 0)
    out = disturb(features, 20, np.random.default_rng(0))
    np.testing.assert_allclose(out[:, 32:, JOINT_POSITIONS], features[:, 32:, JOINT_POSITIONS], atol=1e-5)
    change = np.abs(out[:, :20, JOINT_POSITIONS] - features[:, :20, JOINT_POSITIONS])
    assert 1e-3 < change.mean() < 0.05


def test_heading_difference_wraps_at_two_pi() -> None:
    a = torch.tensor([0.0, 3.0, -3.0, torch.pi])
    b = torch.tensor([torch.pi, -3.0, 3.0, -torch.pi])
    expected = torch.tensor([torch.pi, 6.0 - 2 * torch.pi, 2 * torch.pi - 6.0, 0.0])
    torch.testing.assert_close(wrapped_difference(a, b).abs(), expected.abs(), atol=1e-5, rtol=0)


def test_facing_backwards_is_the_worst_heading() -> None:
    angles = torch.linspace(-torch.pi, torch.pi, 37)
    gap = wrapped_difference(angles, torch.zeros(37)).square()
    assert int(gap.argmin()) == 18
    assert gap[0] > gap[9] > gap[18]


def test_unused_slots_are_zero_and_used_ones_carry_their_arrival() -> None:
    batch = TargetBatch.none(2, 40)
    assert not batch.vector(40).any()
    assert batch.vector(40).shape == (2, TARGET_NUMBERS)
    batch.position_m[1, 6] = torch.tensor([1.0, 2.0, 3.0])
    batch.position_valid[1, 6] = True
    batch.position_frame[1, 6] = 10
    np.testing.assert_allclose(batch.vector(40)[1, 30:35], [1.0, 2.0, 0.0, 1.0, 0.25])


def test_normalizer_inverts() -> None:
    normalizer = Normalizer(torch.randn(263), torch.rand(263) + 0.1)
    x = torch.randn(3, 5, 263)
    torch.testing.assert_close(normalizer.denormalize(normalizer.normalize(x)), x, atol=1e-5, rtol=1e-5)
