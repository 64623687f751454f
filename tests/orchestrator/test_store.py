"""Recordings: what was written is there after a kill, and files are whole or absent."""

from __future__ import annotations

import asyncio
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from orchestrator.core.episode_spec import EpisodeSpec
from orchestrator.core.tape import MEGABYTE, MOST_UNHEARD, Backlog, Tape
from orchestrator.export.formats import to_bvh, to_csv
from orchestrator.store.recordings import Recording, RecordingFiles, from_npz, to_npz
from shared.errors import DeadlineError, NotFoundError
from shared.motion.ik import standing_clip
from shared.motion.io.bvh import read_bvh
from shared.protocol.messages import TickRange
from shared.tasks.specs import HaltSpec

SPEC = EpisodeSpec(tasks=[HaltSpec()])


def ticks(start: int, count: int) -> TickRange:
    """Standing, for `count` ticks."""
    standing = standing_clip(count, 30).positions_w_m.astype("<f4")
    quat = np.zeros((count, 22, 4), "<f4")
    quat[..., 0] = 1
    return TickRange(
        start_tick=start, rate_hz=30, body_pos_w_m=standing, body_quat_w=quat,
        body_linvel_w_mps=np.zeros((count, 22, 3), "<f4"), body_angvel_w_radps=np.zeros((count, 22, 3), "<f4"),
        contacts=np.ones((count, 4), "|u1"), hinge_pos_rad=np.zeros((count, 5)), hinge_vel_radps=np.zeros((count, 5)),
        servo_target_rad=np.zeros((count, 5)), object_pose_w=np.zeros((count, 0, 7), "<f4"),
        object_vel_w=np.zeros((count, 0, 6), "<f4"), contact_sample=np.zeros(0), contact_body=np.zeros(0),
        contact_object=np.zeros(0), contact_impulse_ns=np.zeros(0), tracking_error_m=np.zeros(count, "<f4"),
        fallen=np.zeros(count, "|u1"), reference_pos_w_m=standing,
    )  # fmt: skip


@pytest.mark.parametrize("lengths", [[400] * 5, [100, 700, 100, 900, 300, 300, 10], [650], [1] * 3 + [600] + [599, 1]])
def test_parts_of_any_length_are_gathered_and_none_is_lost(tmp_path: Path, lengths: list[int]) -> None:
    files = RecordingFiles(tmp_path)
    at = 0
    for length in lengths:
        files.add_part("e", Recording.of(ticks(at, length)))
        at += length
        files.add_resume("e", b"state", at - 1)
        assert len(files.recorded("e", at - 1)) == at
    assert len(lengths) == 1 or len(list((tmp_path / "e.parts").glob("*.npz"))) < len(lengths)
    files.finish("e")
    assert len(files.load("e")) == at


def test_a_kill_while_parts_are_gathered_costs_nothing(tmp_path: Path) -> None:
    files, folder = RecordingFiles(tmp_path), tmp_path / "e.parts"
    for start in (0, 250, 500):
        files.add_part("e", Recording.of(ticks(start, 250)))
    small = {file.name: file.read_bytes() for file in folder.glob("*.npz")}
    files.add_resume("e", b"state", 749)
    assert len(list(folder.glob("*.npz"))) == 1
    for name, data in small.items():  # as if it had been killed before they were removed
        (folder / name).write_bytes(data)
    for start in (750, 1000, 1250):
        files.add_part("e", Recording.of(ticks(start, 250)))
        files.add_resume("e", b"state", start + 249)
    assert len(files.recorded("e", 1499)) == 1500
    files.finish("e")
    assert len(files.load("e")) == 1500


def test_who_was_killed_before_its_end_was_noted_has_no_recording_until_it_ends_again(tmp_path: Path) -> None:
    files = RecordingFiles(tmp_path)
    files.add_part("e", Recording.of(ticks(0, 90)))
    files.add_resume("e", b"state", 89)
    files.add_part("e", Recording.of(ticks(90, 34)))
    files.finish("e", drop=False)
    assert len(files.load("e")) == 124
    assert len(files.recorded("e", 89)) == 90
    with pytest.raises(NotFoundError):
        files.load("e")


def test_what_is_newer_than_the_state_to_go_on_from_is_dropped(tmp_path: Path) -> None:
    files = RecordingFiles(tmp_path)
    files.add_part("e", Recording.of(ticks(0, 40)))
    files.add_resume("e", b"state at 39", 39)
    files.add_part("e", Recording.of(ticks(40, 700)))
    files.add_resume("e", b"state at 39", 39)  # it is not gathered into one with what is newer
    assert len(files.recorded("e", 39)) == 40
    assert files.resume("e") == b"state at 39"
    with pytest.raises(NotFoundError, match="not all of the ticks"):
        files.recorded("e", 59)


def test_a_recording_comes_back_as_it_was(tmp_path: Path) -> None:
    files = RecordingFiles(tmp_path)
    files.add_part("e", Recording.of(ticks(0, 10)))
    files.add_part("e", Recording.of(ticks(10, 5)))
    path = files.finish("e")
    assert path is not None
    recording = from_npz(path)
    np.testing.assert_array_equal(recording.arrays["body_pos_w_m"], ticks(0, 15).body_pos_w_m)
    assert not list(tmp_path.glob("*.partial"))
    assert not list(tmp_path.glob("*.parts"))
    assert to_npz(recording)[:2] == b"PK"
    files.delete("e")
    with pytest.raises(NotFoundError):
        files.load("e")


def test_exports_hold_the_motion(tmp_path: Path) -> None:
    files = RecordingFiles(tmp_path)
    files.add_part("e", Recording.of(ticks(0, 12)))
    path = files.finish("e")
    assert path is not None
    recording: Recording = from_npz(path)
    lines = to_csv(recording).decode().splitlines()
    assert len(lines) == 13
    assert lines[0].startswith("tick,time_s,pelvis_x_m")
    assert lines[-1].startswith("11,0.3667,")
    bvh = tmp_path / "motion.bvh"
    bvh.write_bytes(to_bvh(recording))
    raw = read_bvh(bvh)
    assert raw.fps == pytest.approx(30, abs=1e-3)
    assert len(raw.positions_w_m) == 12


@pytest.mark.parametrize(("times", "whole"), [(2, True), (MOST_UNHEARD + 1, False)])
def test_ticks_of_a_tracker_that_is_not_heard_at_the_end_are_asked_for_again(
    tmp_path: Path, times: int, whole: bool
) -> None:
    told, unheard = list[str](), [DeadlineError("no reply") for _ in range(times)]

    async def answer(start: int, stop: int, rate_hz: int, reference: bool) -> TickRange:
        if unheard:
            raise unheard.pop()
        return ticks(start, stop - start)

    runner: Any = SimpleNamespace(
        session=SimpleNamespace(created=True, on_rewind=[], scene=None, loop=SimpleNamespace(ticks=answer)),
        spec=SimpleNamespace(character="human"), episode_id="e", tick=89,
        events=SimpleNamespace(emit=lambda type_, tick, **more: told.append(type_)),
    )  # fmt: skip
    files = RecordingFiles(tmp_path)

    async def finished() -> int:
        tape, tries = Tape(runner, files, Backlog(MEGABYTE)), 1
        while not await tape.finish(90):
            tries += 1
        return tries

    assert asyncio.run(finished()) == min(times, MOST_UNHEARD) + 1
    if whole:
        assert len(files.load("e")) == 90 and not told
    else:
        assert told == ["recording_failed"]
