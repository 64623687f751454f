"""The recorder returns exactly what was appended, from memory or disk."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shared.errors import InvalidInputError
from tracker_service.simulation.recorder import Recorder, RecordingLostError, Samples


def rows(first: int, count: int, objects: int = 1) -> Samples:
    index = np.arange(first, first + count, dtype=np.float32)
    return {"x": index[:, None] * np.ones(3, np.float32), "pose": np.tile(index[:, None, None], (1, objects, 7))}


def filled(folder: Path, count: int, chunk: int = 8, memory: int = 2) -> Recorder:
    recorder = Recorder(folder, chunk_samples=chunk, memory_chunks=memory)
    for first in range(0, count, 2):
        recorder.append(rows(first, min(2, count - first)))
    return recorder


@given(st.integers(1, 60), st.integers(-20, 60), st.integers(-20, 60), st.sampled_from([1, 2, 3]))
def test_reads_the_samples_asked_for(
    tmp_path_factory: pytest.TempPathFactory, count: int, start: int, stop: int, stride: int
) -> None:
    recorder = filled(tmp_path_factory.mktemp("r"), count)
    stop = min(stop, count)
    wanted = np.maximum(np.arange(start, stop, stride), 0)
    np.testing.assert_array_equal(recorder.read(start, stop, stride)["x"][:, 0], wanted)
    recorder.close()


def test_memory_is_bounded_and_the_disk_has_the_rest(tmp_path: Path) -> None:
    recorder = filled(tmp_path / "r", 800)
    assert recorder.spilled_chunks == 98
    assert recorder.memory_bytes <= 3 * 8 * (12 + 28)
    np.testing.assert_array_equal(recorder.read(0, 800)["x"][:, 1], np.arange(800))
    recorder.close()
    assert not (tmp_path / "r").exists()


def test_truncate_then_go_on_rewrites_the_future(tmp_path: Path) -> None:
    recorder = filled(tmp_path, 100)
    recorder.truncate(21)
    assert recorder.next_sample == 21
    recorder.append({name: np.negative(array) for name, array in rows(21, 4).items()})
    np.testing.assert_array_equal(recorder.read(18, 25)["x"][:, 0], [18, 19, 20, -21, -22, -23, -24])


def test_rows_of_an_earlier_scene_are_fitted_to_the_newest(tmp_path: Path) -> None:
    recorder = filled(tmp_path, 10)
    recorder.append(rows(10, 3, objects=2))
    pose = recorder.read(8, 13)["pose"]
    assert pose.shape == (5, 2, 7)
    assert pose[1, 1].max() == 0
    assert pose[1, 0].min() == 9
    assert pose[-1].min() == 12


def test_a_full_disk_loses_nothing(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("in the way of the folder")
    recorder = filled(blocked / "r", 100)
    assert recorder.spill_failures > 0
    assert recorder.spilled_chunks == 0
    np.testing.assert_array_equal(recorder.read(0, 100)["x"][:, 0], np.arange(100))
    blocked.unlink()
    recorder.append(rows(100, 8))
    assert recorder.spilled_chunks > 0
    np.testing.assert_array_equal(recorder.read(0, 108)["x"][:, 0], np.arange(108))


def test_a_lost_file_and_the_future_are_clear_errors(tmp_path: Path) -> None:
    recorder = filled(tmp_path, 100)
    with pytest.raises(InvalidInputError, match="99 is the last"):
        recorder.read(0, 101)
    for path in tmp_path.glob("*.npz"):
        path.write_bytes(b"not a recording")
    with pytest.raises(RecordingLostError, match="cannot be read"):
        recorder.read(0, 100)
    assert recorder.read(95, 100)["x"].shape == (5, 3)


@pytest.mark.parametrize(("start", "stop", "stride"), [(0, 21, 4), (8, 30, 4), (3, 29, 1), (-12, 17, 4), (6, 6, 4)])
def test_sums_are_over_the_samples_up_to_each_row(tmp_path: Path, start: int, stop: int, stride: int) -> None:
    recorder = Recorder(tmp_path / "spool", chunk_samples=7, memory_chunks=1)
    values = np.arange(1.0, 31.0).reshape(30, 1)
    for first in range(0, 30, 3):
        recorder.append({"x": values[first : first + 3], "other": np.zeros((3, 2))})
    wanted = [
        [values[max(0, row - stride + 1) : max(0, row + 1)].sum()] if stride > 1 else values[max(row, 0)]
        for row in range(start, stop, stride)
    ]
    np.testing.assert_array_equal(recorder.read_sums("x", start, stop, stride), np.reshape(wanted, (-1, 1)))
