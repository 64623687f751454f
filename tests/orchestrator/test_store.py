"""Store and recordings: what was written is there after a kill, and files are whole or absent."""

from __future__ import annotations

import asyncio
import multiprocessing
import os
import signal
import sqlite3
from pathlib import Path

import numpy as np
import pytest

from orchestrator.core.episode_spec import EpisodeOutcome, EpisodeSpec
from orchestrator.export.formats import to_bvh, to_csv
from orchestrator.rest import Event
from orchestrator.store.database import SqliteStore
from orchestrator.store.interface import Store, StoreReader
from orchestrator.store.recordings import Recording, RecordingFiles, from_npz, to_npz
from shared.errors import NotFoundError
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


def _run_and_die(folder: Path) -> None:
    store = SqliteStore(folder)
    store.episode_started("e1", SPEC, {})
    store.event("e1", Event(seq=1, type="state", tick=3, unix_s=0.0, data={"after": "acting"}))
    files = RecordingFiles(store.recordings)
    files.add_part("e1", Recording.of(ticks(0, 40)))
    files.add_part("e1", Recording.of(ticks(40, 20)))
    store.flush()
    os.kill(os.getpid(), signal.SIGKILL)


def test_after_a_kill_running_episodes_are_interrupted_with_all_recorded_ticks(tmp_path: Path) -> None:
    child = multiprocessing.get_context("spawn").Process(target=_run_and_die, args=(tmp_path,))
    child.start()
    child.join(60)
    assert child.exitcode == -signal.SIGKILL
    store = SqliteStore(tmp_path)
    assert store.left_running() == (["e1"], [])
    store.mark_interrupted(["e1"], [])
    row = store.episode("e1")
    assert row["status"] == "interrupted"
    assert "stopped" in row["reason"]
    assert [event.type for event in store.events("e1")] == ["state"]
    files = RecordingFiles(store.recordings)
    assert files.unfinished() == ["e1"]
    files.finish("e1")
    assert len(files.load("e1")) == 60
    assert files.unfinished() == []
    store.close()


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


def test_episodes_are_filtered_paged_and_deleted(tmp_path: Path) -> None:
    store = SqliteStore(tmp_path)
    outcome = EpisodeOutcome(
        status="finished", reason=None, success=True, results=[], ticks=90, plans=6, missed_ticks=0
    )
    for i in range(5):
        store.episode_started(f"e{i}", SPEC, {})
        if i % 2:
            store.episode_ended(f"e{i}", outcome)
    rows, total = store.episodes("finished", 1, 0)
    assert total == 2
    assert [row["id"] for row in rows] == ["e3"]
    assert rows[0]["outcome"]["ticks"] == 90
    assert [row["id"] for row in store.episodes(None, 2, 3)[0]] == ["e1", "e0"]
    store.delete_episode("e3")
    with pytest.raises(NotFoundError, match="e3"):
        store.episode("e3")
    store.close()


def test_a_locked_store_loses_nothing(tmp_path: Path) -> None:
    store = SqliteStore(tmp_path)
    store.flush()
    other = sqlite3.connect(tmp_path / "motionloop.sqlite", isolation_level=None)
    other.execute("BEGIN EXCLUSIVE")
    store.event("e", Event(seq=1, type="x", tick=0, unix_s=0.0))
    assert not store.flush(0.2)
    other.execute("COMMIT")
    other.close()
    assert [event.seq for event in store.events("e")] == [1]
    store.close()


def test_a_locked_store_holds_up_nobody_but_those_who_ask_it(tmp_path: Path) -> None:
    """Notes are taken at once, readers wait beside the event loop, and other threads' work goes on meanwhile."""
    store: Store = SqliteStore(tmp_path)
    other = sqlite3.connect(tmp_path / "motionloop.sqlite", isolation_level=None)
    other.execute("BEGIN EXCLUSIVE")

    async def run() -> list[int]:
        reader = StoreReader(store)
        store.event("e", Event(seq=1, type="x", tick=0, unix_s=0.0))
        asked = [asyncio.create_task(reader.events("e")) for _ in range(20)]  # far more than there are threads
        for turn in range(10):
            await asyncio.sleep(0)
            store.event("e", Event(seq=turn + 2, type="x", tick=0, unix_s=0.0))
            await asyncio.to_thread(RecordingFiles(store.recordings).add_part, "e", Recording.of(ticks(turn, 1)))
        assert not any(task.done() for task in asked)
        other.execute("COMMIT")
        found = await asyncio.gather(*asked)
        await reader.close()
        return [event.seq for event in found[-1]]

    assert asyncio.run(run()) == list(range(1, 12))
    other.close()


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
