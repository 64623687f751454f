"""The cost of a tick, measured in process."""

from __future__ import annotations

from tracker_service.training.bench import bench_tracker


def test_every_number_of_the_bench_is_there() -> None:
    result = bench_tracker("pd", ticks=2, envs=2)
    numbers = [result[name] for name in ("tick_us", "mj_step_us", "ratio", "train_samples_per_s")]
    assert all(isinstance(number, float) and number > 0 for number in numbers), result
