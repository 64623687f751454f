"""Plan buffer, prefix and junctions: frames are absolute, and nothing jumps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.core.stitch import (
    PlanBuffer,
    build_prefix,
    error_decay,
    frame_of_tick,
    last_frame_by,
    since,
    start_tick_for,
)
from shared.errors import InvalidInputError

SPEED_MPS = 1.2


def walk(start: int, stop: int, offset_m: float = 0.0) -> np.ndarray:
    """(T, 2, 3) two joints moving along x at constant speed, frames start..stop-1."""
    out = np.zeros((stop - start, 2, 3))
    out[..., 0] = (np.arange(start, stop) / 20 * SPEED_MPS + offset_m)[:, None]
    out[:, 1, 2] = 1.0
    return out


def test_ticks_and_frames_agree_in_time() -> None:
    assert frame_of_tick(30) == 20
    assert [last_frame_by(t) for t in range(7)] == [0, 0, 1, 2, 2, 3, 4]
    with pytest.raises(InvalidInputError, match="tick 31"):
        frame_of_tick(31)


@given(st.integers(0, 10_000), st.integers(0, 60))
def test_a_plan_starts_at_the_first_frame_tick_after_the_lead(now: int, lead: int) -> None:
    start = start_tick_for(now, lead)
    assert start % 3 == 0
    assert 0 <= start - (now + lead) < 3


def test_a_new_plan_replaces_what_comes_after_its_first_frame() -> None:
    buffer = PlanBuffer()
    buffer.put(1, walk(1, 41))
    buffer.put(11, walk(11, 51, offset_m=5.0))
    assert (buffer.first_frame, buffer.end_frame) == (1, 51)
    np.testing.assert_allclose(buffer.get(9, 13)[:, 0, 0], [0.54, 0.6, 5.66, 5.72])
    np.testing.assert_allclose(buffer.get(49, 53)[:, 0, 0], [7.94, 8.0, 8.0, 8.0])
    with pytest.raises(InvalidInputError):
        buffer.get(0, 3)


def test_a_plan_that_does_not_touch_the_old_one_starts_the_buffer_anew() -> None:
    buffer = PlanBuffer()
    buffer.put(1, walk(1, 11))
    buffer.put(31, walk(31, 41))
    assert (buffer.first_frame, buffer.end_frame) == (31, 41)
    buffer.clear()
    assert not buffer.has(31)


def test_the_error_decays_from_one_to_zero_smoothly() -> None:
    t = np.linspace(0, 0.7, 701)
    w = error_decay(t)
    assert w[0] == 1.0
    assert w[500:].max() == 0.0
    assert (np.diff(w) <= 0).all()
    assert np.abs(np.diff(w, 2)).max() < 2e-4  # no kink: slope changes by less than 0.1 /s in a millisecond


@given(st.integers(0, 18), st.floats(-0.2, 0.2))
def test_no_jump_where_simulation_meets_the_old_plan(gap: int, error_m: float) -> None:
    """The old plan's rest is shifted to where the simulation is: steps stay within the motion's own."""
    buffer = PlanBuffer()
    buffer.put(80, walk(80, 140))
    simulated = walk(79, 101, offset_m=error_m)
    prefix = build_prefix(simulated, 100, 100 + gap, buffer)
    assert prefix.positions_w_m.shape == (20, 2, 3)
    assert prefix.context_frames == gap
    steps = np.diff(prefix.positions_w_m[:, 0, 0])
    own_step = SPEED_MPS / 20
    slope = np.abs(np.diff(error_decay(np.arange(12) / 20))).max()
    assert np.abs(steps - own_step).max() <= slope * abs(error_m) + 1e-9
    np.testing.assert_allclose(prefix.velocities_w_mps[1:, 0, 0], steps * 20, atol=1e-9)


def test_after_the_decay_the_prefix_is_the_old_plan() -> None:
    buffer = PlanBuffer()
    buffer.put(90, walk(90, 140))
    prefix = build_prefix(walk(79, 101, offset_m=0.1), 100, 112, buffer)
    np.testing.assert_allclose(prefix.positions_w_m[-2:], walk(111, 113))


def test_without_a_plan_the_last_pose_is_held() -> None:
    prefix = build_prefix(walk(79, 101), 100, 104, PlanBuffer())
    np.testing.assert_allclose(prefix.positions_w_m[-4:], np.repeat(walk(100, 101), 4, axis=0))
    assert prefix.context_frames == 4


def test_with_no_lead_the_prefix_is_the_simulation_alone() -> None:
    buffer = PlanBuffer()
    buffer.put(80, walk(80, 140, offset_m=3.0))
    prefix = build_prefix(walk(79, 101), 100, 100, buffer)
    np.testing.assert_allclose(prefix.positions_w_m, walk(81, 101))
    assert prefix.context_frames == 0


def test_a_prefix_cannot_end_before_now_and_needs_its_frames() -> None:
    with pytest.raises(InvalidInputError, match="before now"):
        build_prefix(walk(79, 101), 100, 99, PlanBuffer())
    with pytest.raises(InvalidInputError, match="simulated frames"):
        build_prefix(walk(90, 101), 100, 100, PlanBuffer())


def test_after_a_reset_the_prefix_holds_no_frame_from_before_it() -> None:
    frames = np.arange(10.0)[:, None, None] * np.ones((1, 22, 3))  # frames 11..20
    np.testing.assert_array_equal(since(frames, 20, 18)[:, 0, 0], [7, 7, 7, 7, 7, 7, 7, 7, 8, 9])
    np.testing.assert_array_equal(since(frames, 20, 20)[:, 0, 0], [9] * 10)
    np.testing.assert_array_equal(since(frames, 20, 22)[:, 0, 0], [9] * 10)
    np.testing.assert_array_equal(since(frames, 20, 0), frames)
