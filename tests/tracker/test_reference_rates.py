"""The reference takes plans at every rate a planner may have, and goes over from one to another without a jump."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shared.errors import InvalidInputError
from shared.motion.ik import standing_clip
from shared.protocol.rates import PLANNER_RATES, first_start_by
from tracker_service.simulation.character_spec import HUMAN
from tracker_service.simulation.humanoid import humanoid
from tracker_service.simulation.reference import ReferenceBuffer

HUMANOID = humanoid(HUMAN)
ACCELERATION = 0.6


def gliding(start_tick: int, fps: int, seconds: float, from_tick: int) -> np.ndarray:
    """(T, 22, 3) the standing pose, off from rest at `from_tick`, as a plan from `start_tick` on."""
    count = max(4, round(seconds * fps))
    since_s = (start_tick - from_tick) / 30 + np.arange(1, count + 1) / fps
    positions = np.array(standing_clip(count, fps).positions_w_m, dtype=np.float64)
    positions[:, :, 0] += (ACCELERATION / 2 * since_s**2)[:, None]
    return positions


def way(buffer: ReferenceBuffer, tick: int, count: int) -> np.ndarray:
    return buffer.at(tick, count).pos_w_m[:, 0, 0]


@pytest.mark.parametrize("fps", PLANNER_RATES)
def test_ticks_are_where_the_plan_is_at_their_time(fps: int) -> None:
    buffer = ReferenceBuffer(HUMANOID, 0, (0.0, 0.0), 0.0)
    start = first_start_by(9, fps)
    buffer.insert(start, gliding(start, fps, 2.0, start), 0, fps)
    assert buffer.plan_end_tick == start + 60
    ticks = np.arange(start, start + 61)
    np.testing.assert_allclose(way(buffer, start, 61), ACCELERATION / 2 * ((ticks - start) / 30) ** 2, atol=0.005)
    np.testing.assert_allclose(way(buffer, 0, start), 0.0, atol=0.005)
    after = np.abs(np.diff(way(buffer, start + 60, 40)))
    assert after.max() <= 1.3 / 30, "it coasts into a stand"
    assert after[-5:].max() < 1e-9


@settings(max_examples=15)
@given(
    rates=st.lists(st.sampled_from(PLANNER_RATES), min_size=2, max_size=4),
    gap=st.integers(4, 40),
    seconds=st.floats(0.8, 2.5),
)
def test_planners_of_different_rates_take_over_from_each_other(rates: list[int], gap: int, seconds: float) -> None:
    buffer = ReferenceBuffer(HUMANOID, 0, (0.0, 0.0), 0.0)
    now, shown = 0, []
    for fps in rates:
        start = first_start_by(now, fps)
        before = buffer.at(now - 10, 11).pos_w_m
        buffer.insert(start, gliding(start, fps, seconds + gap / 30, 0), now, fps)
        np.testing.assert_array_equal(buffer.at(now - 10, 11).pos_w_m, before, "what has been shown stays")
        shown.append(way(buffer, now, gap))
        now += gap
    seen = np.concatenate(shown)
    # Every plan continues the same glide, so that only the resampling of it can show.
    np.testing.assert_allclose(seen, ACCELERATION / 2 * (np.arange(now) / 30) ** 2, atol=0.01)
    assert np.abs(np.diff(seen, 2)).max() < 0.01


def test_a_change_of_rate_survives_a_snapshot_and_a_start_between_frames_is_refused() -> None:
    buffer = ReferenceBuffer(HUMANOID, 12, (0.0, 0.0), 0.0)
    with pytest.raises(InvalidInputError) as caught:
        buffer.insert(20, gliding(20, 8, 1.0, 20), 12, 8)
    assert (caught.value.field, caught.value.allowed) == ("start_tick", "multiples of 15")
    buffer.insert(15, gliding(15, 8, 1.0, 15), 12, 8)
    twin = ReferenceBuffer(HUMANOID, 0, (0.0, 0.0), 0.0)
    twin.from_arrays(buffer.to_arrays())
    for each in (buffer, twin):
        each.insert(30, gliding(30, 40, 1.0, 15), 20, 40)
    np.testing.assert_array_equal(buffer.at(0, 80).qpos, twin.at(0, 80).qpos)
