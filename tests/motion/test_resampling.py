"""The seam between 20, 30 and 60 Hz: no lag, no change of speed (REFERENCE 4.1)."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from shared.errors import InvalidInputError
from shared.motion.resampling import finite_velocity, resample, sample_at
from tests.motion.helpers import seeds, smooth_motion

RATES = [(20.0, 30.0), (30.0, 20.0), (60.0, 20.0), (60.0, 30.0), (20.0, 60.0), (120.0, 30.0)]
INTERIOR_S = 0.25
"""Near its ends a motion is seen from one side only, and fewer samples carry the estimate."""


def _sine(rate: float, frequency: float, phase: float, seconds: float = 2.0) -> np.ndarray:
    return np.sin(2 * np.pi * frequency * np.arange(round(seconds * rate) + 1) / rate + phase)


@pytest.mark.parametrize(("fps_in", "fps_out"), RATES)
@given(velocity=st.floats(-3, 3), start=st.floats(-5, 5))
def test_constant_velocity_is_kept_exactly(fps_in: float, fps_out: float, velocity: float, start: float) -> None:
    x = start + velocity * np.arange(41) / fps_in
    y = resample(x, fps_in, fps_out)
    assert_allclose(y, start + velocity * np.arange(len(y)) / fps_out, atol=1e-9)


@pytest.mark.parametrize(("fps_in", "fps_out"), RATES)
@given(frequency=st.floats(0.1, 2.0), phase=st.floats(0, 6.28))
def test_sines_keep_time_and_speed(fps_in: float, fps_out: float, frequency: float, phase: float) -> None:
    """Inside the motion: timing within 1 ms (its fundamental's phase) and speed within 0.1 % of the largest speed."""
    y = resample(_sine(fps_in, frequency, phase), fps_in, fps_out)
    truth = _sine(fps_out, frequency, phase)[: len(y)]
    t = np.arange(len(y)) / fps_out
    inside = (t >= INTERIOR_S) & (t <= 2.0 - INTERIOR_S)
    top_speed = 2 * np.pi * frequency
    assert np.abs(y - truth)[inside].max() / top_speed < 1e-3
    speed_error = np.abs(finite_velocity(y, fps_out) - finite_velocity(truth, fps_out))
    assert speed_error[inside].max() / top_speed < 1e-3


@given(frequency=st.floats(0.1, 2.0), phase=st.floats(0, 6.28))
def test_the_ends_keep_time_too(frequency: float, phase: float) -> None:
    y = resample(_sine(20.0, frequency, phase), 20.0, 30.0)
    truth = _sine(30.0, frequency, phase)[: len(y)]
    assert np.abs(y - truth).max() / (2 * np.pi * frequency) < 1e-3


@given(seeds)
def test_the_prefix_from_the_log_is_made_of_samples_not_of_interpolations(seed: int) -> None:
    """60 Hz log -> 20 fps prefix: every third sample, bit for bit; and likewise every second one for the ticks."""
    log = smooth_motion(np.random.default_rng(seed), 61, 60.0)
    assert (resample(log, 60.0, 20.0) == log[::3]).all()
    assert (resample(log, 60.0, 30.0) == log[::2]).all()


@given(seeds)
def test_twenty_to_thirty_and_back_gives_the_shared_samples(seed: int) -> None:
    """Every third tick and every second frame are the same instant and stay untouched."""
    plan = smooth_motion(np.random.default_rng(seed), 41, 20.0)
    ticks = resample(plan, 20.0, 30.0)
    assert len(ticks) == 61
    assert (ticks[::3] == plan[::2]).all()
    again = resample(ticks, 30.0, 20.0)
    assert (again[::2] == plan[::2]).all()
    # Chained joints move faster than 2 Hz, hence half a millimetre and not less.
    assert np.abs(again - plan)[5:-5].max() < 5e-4


def test_lengths_end_at_the_last_instant_covered() -> None:
    assert resample(np.zeros((41, 2)), 20, 30).shape == (61, 2)
    assert resample(np.zeros((40, 2)), 20, 30).shape == (59, 2)
    assert resample(np.zeros((20, 3)), 30, 20).shape == (13, 3)
    assert resample(np.zeros((1, 3)), 30, 20).shape == (1, 3)
    assert resample(np.zeros((0, 3)), 30, 20).shape == (0, 3)


def test_two_samples_are_joined_by_a_line() -> None:
    assert_allclose(resample(np.array([0.0, 3.0]), 10.0, 30.0), [0.0, 1.0, 2.0, 3.0], atol=1e-12)


def test_sampling_outside_the_motion_is_refused() -> None:
    with pytest.raises(InvalidInputError):
        sample_at(np.zeros(5), np.array([4.5]))
    with pytest.raises(InvalidInputError):
        resample(np.zeros(5), 0.0, 30.0)


def test_velocity_looks_back_and_repeats_its_first_row() -> None:
    assert_allclose(finite_velocity(np.array([0.0, 1.0, 3.0]), 10.0), [10.0, 10.0, 20.0], atol=1e-12)
    assert_allclose(finite_velocity(np.array([4.0]), 10.0), [0.0], atol=0)
