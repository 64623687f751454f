"""Plan buffer, prefix and junctions: frames are absolute, and nothing jumps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.core.stitch import (
    LogWindow,
    PlanBuffer,
    Prefix,
    build_prefix,
    error_decay,
    log_window,
    since,
    start_tick_for,
)
from shared.errors import InvalidInputError
from shared.protocol.rates import PLANNER_RATES, start_spacing

SPEED_MPS = 1.2


def walk(start: int, stop: int, offset_m: float = 0.0) -> np.ndarray:
    """(T, 2, 3) two joints moving along x at constant speed, frames start..stop-1."""
    out = np.zeros((stop - start, 2, 3))
    out[..., 0] = (np.arange(start, stop) / 20 * SPEED_MPS + offset_m)[:, None]
    out[:, 1, 2] = 1.0
    return out


def joined(simulated: np.ndarray, last: int, end: int, buffer: PlanBuffer, frames: int = 20) -> Prefix:
    """The prefix of walks whose velocity the simulation knows."""
    velocities = np.zeros_like(simulated)
    velocities[..., 0] = SPEED_MPS
    return build_prefix(simulated, velocities, last, end, buffer, frames)


def test_the_window_of_the_log_at_20_fps() -> None:
    """Tick 7 is 0.233 s: the last frame is 4 (0.2 s), the first of 20 and one before is -16 (-0.8 s, tick -24).
    Tick 9 is frame 6, the first then -14, a tick; tick 8 is after frame 5, and -15 lies between ticks.
    """
    assert log_window(7, 20, 20) == LogWindow(start_tick=-24, stop_tick=8, skip=0, frames=21, last_frame=4)
    assert log_window(8, 20, 20) == LogWindow(start_tick=-24, stop_tick=9, skip=1, frames=21, last_frame=5)
    assert log_window(9, 20, 20) == LogWindow(start_tick=-21, stop_tick=10, skip=0, frames=21, last_frame=6)


@given(fps=st.sampled_from(PLANNER_RATES), now=st.integers(0, 10_000), frames=st.integers(1, 60))
def test_the_window_holds_the_frames_up_to_now_and_nothing_is_between_samples(fps: int, now: int, frames: int) -> None:
    window = log_window(now, frames, fps)
    stride = 120 // fps
    samples = np.arange(window.start_tick * 4, window.stop_tick * 4, stride)  # what GetTicks answers
    rows = window.rows(samples)
    assert len(rows) == frames + 1
    np.testing.assert_array_equal(np.diff(rows), stride)
    assert rows[-1] == window.last_frame * stride, "the sample of its frame"
    assert 0 <= now * 4 - rows[-1] < stride, "the last before or at now"


@given(st.integers(0, 10_000), st.integers(0, 60), st.sampled_from(PLANNER_RATES))
def test_a_plan_starts_at_the_first_frame_tick_after_the_lead(now: int, lead: int, fps: int) -> None:
    start = start_tick_for(now, lead, fps)
    assert start * fps % 30 == 0
    assert 0 <= start - (now + lead) < start_spacing(fps)


@given(st.sampled_from(PLANNER_RATES), st.sampled_from(PLANNER_RATES))
def test_a_planner_of_another_rate_goes_on_from_what_is_planned(old: int, new: int) -> None:
    buffer = PlanBuffer(old)
    buffer.put(old, (np.arange(old, 4 * old) / old)[:, None, None] * np.ones((1, 2, 3)))  # the value is the time
    other = buffer.at_rate(new)
    assert other.fps == new
    assert other.first_frame == new
    assert (other.end_frame - 1) / new <= 4 - 1 / old < other.end_frame / new
    frames = np.arange(other.first_frame, other.end_frame)
    np.testing.assert_allclose(other.get(new, other.end_frame)[:, 0, 0], frames / new, atol=1e-9)
    assert not PlanBuffer(old).at_rate(new).has(0)


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
    prefix = joined(simulated, 100, 100 + gap, buffer)
    assert prefix.positions_w_m.shape == (20, 2, 3)
    assert prefix.context_frames == gap
    steps = np.diff(prefix.positions_w_m[:, 0, 0])
    own_step = SPEED_MPS / 20
    slope = np.abs(np.diff(error_decay(np.arange(12) / 20))).max()
    assert np.abs(steps - own_step).max() <= slope * abs(error_m) + 1e-9
    # The simulation's own where it simulated, differences in the rest of the old plan.
    np.testing.assert_array_equal(prefix.velocities_w_mps[: 20 - gap, 0, 0], SPEED_MPS)
    if gap:
        np.testing.assert_allclose(prefix.velocities_w_mps[-gap:, 0, 0], steps[-gap:] * 20, atol=1e-9)


def test_after_the_decay_the_prefix_is_the_old_plan() -> None:
    buffer = PlanBuffer()
    buffer.put(90, walk(90, 140))
    prefix = joined(walk(79, 101, offset_m=0.1), 100, 112, buffer)
    np.testing.assert_allclose(prefix.positions_w_m[-2:], walk(111, 113))


@given(begins=st.integers(101, 110), gap=st.integers(1, 18))
def test_a_plan_that_has_still_to_begin_is_what_the_next_goes_on_from(begins: int, gap: int) -> None:
    """Standing at frame 100; a walk is to begin at a later frame: the prefix of the plan after it walks, too."""
    still = np.repeat(walk(0, 1), 22, axis=0)
    buffer = PlanBuffer()
    buffer.put(begins, walk(1, 60))  # it begins a step from where the body stands
    prefix = joined(still, 100, 100 + gap, buffer)
    way = np.maximum(np.arange(101, 101 + gap) - begins + 1, 0) * SPEED_MPS / 20
    off = prefix.positions_w_m[-gap:, 0, 0] - way
    assert np.abs(off).max() <= SPEED_MPS / 20 + 1e-9, "at most the first step is made early"
    assert np.abs(np.diff(prefix.positions_w_m[:, 0, 0])).max() < 1.3 * SPEED_MPS / 20


def test_without_a_plan_the_last_pose_is_held() -> None:
    prefix = joined(walk(79, 101), 100, 104, PlanBuffer())
    np.testing.assert_allclose(prefix.positions_w_m[-4:], np.repeat(walk(100, 101), 4, axis=0))
    assert prefix.context_frames == 4
    forgotten = PlanBuffer()
    forgotten.put(102, walk(102, 140))
    forgotten.clear()
    after_reset = joined(walk(79, 101), 100, 104, forgotten)
    np.testing.assert_array_equal(after_reset.positions_w_m, prefix.positions_w_m)


def test_with_no_lead_the_prefix_is_the_simulation_alone() -> None:
    buffer = PlanBuffer()
    buffer.put(80, walk(80, 140, offset_m=3.0))
    prefix = joined(walk(79, 101), 100, 100, buffer)
    np.testing.assert_allclose(prefix.positions_w_m, walk(81, 101))
    assert prefix.context_frames == 0


def test_a_prefix_cannot_end_before_now_and_needs_its_frames() -> None:
    with pytest.raises(InvalidInputError, match="before now"):
        joined(walk(79, 101), 100, 99, PlanBuffer())
    with pytest.raises(InvalidInputError, match="simulated frames"):
        joined(walk(90, 101), 100, 100, PlanBuffer())


def test_a_prefix_of_one_frame_and_of_sixty() -> None:
    buffer = PlanBuffer(fps=60)
    buffer.put(80, walk(80, 140))
    one = joined(walk(99, 101), 100, 100, buffer, 1)
    np.testing.assert_array_equal(one.positions_w_m, walk(100, 101))
    sixty = joined(walk(40, 101), 100, 130, buffer, 60)
    assert sixty.positions_w_m.shape == (60, 2, 3)
    assert sixty.context_frames == 30
    np.testing.assert_allclose(sixty.velocities_w_mps[-30:, 0, 0], SPEED_MPS / 20 * 60, atol=1e-9)
    late = joined(walk(99, 101), 100, 130, buffer, 1)
    assert late.context_frames == 1, "the one frame is of the old plan"
    np.testing.assert_allclose(late.positions_w_m, walk(130, 131))


def test_after_a_reset_the_prefix_holds_no_frame_from_before_it() -> None:
    frames = np.arange(10.0)[:, None, None] * np.ones((1, 22, 3))  # frames 11..20
    for first, expected in ((18, [7] * 8 + [8, 9]), (20, [9] * 10), (22, [9] * 10), (0, list(range(10)))):
        positions, velocities = since(frames, frames + 1, 20, first)
        np.testing.assert_array_equal(positions[:, 0, 0], expected)
        still = max(0, min(9 - (20 - first), 9))
        np.testing.assert_array_equal(velocities[:, 0, 0], [0] * still + list(range(still + 1, 11)))


def test_a_plan_that_was_forgotten_before_it_began_is_no_part_of_a_prefix() -> None:
    buffer = PlanBuffer()
    buffer.put(12, np.ones((40, 22, 3)))
    buffer.clear()
    still = np.zeros((21, 22, 3))
    prefix = build_prefix(still, still, last_simulated_frame=10, end_frame=18, buffer=buffer, prefix_frames=20)
    np.testing.assert_array_equal(prefix.positions_w_m, 0.0)
