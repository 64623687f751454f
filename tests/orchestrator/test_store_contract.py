"""What a store keeps its word about, in SQLite and in a real PostgreSQL server."""

from __future__ import annotations

import asyncio
import multiprocessing
import os
import signal
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import psycopg
import pytest

from orchestrator.client import Client
from orchestrator.core.episode_spec import EpisodeOutcome, EpisodeSpec
from orchestrator.core.supervise import Stack
from orchestrator.rest import Event, TaskResult
from orchestrator.store.choice import open_store
from orchestrator.store.interface import Store, StoreReader
from orchestrator.store.queued import RefusedError
from orchestrator.store.recordings import Recording, RecordingFiles
from shared.errors import ConflictError, NotFoundError
from shared.tasks.specs import HaltSpec
from tests.orchestrator.support import kept_up, light
from tests.orchestrator.test_faults import wait_for
from tests.orchestrator.test_rescue import ended, first_event
from tests.orchestrator.test_resume import answers
from tests.orchestrator.test_store import ticks
from tests.postgres import PostgresServer, programs

SPEC = EpisodeSpec(tasks=[HaltSpec()])
RESULT = TaskResult(
    index=0, name="halt", type="halt", label="halt", success_strict=True, success_paper=True, success_code=True,
    fell=False, seconds=3.0, start_tick=0, stop_tick=90, reason=None, measures={},
)  # fmt: skip
OUTCOME = EpisodeOutcome(
    status="finished", reason=None, success=True, results=[RESULT], ticks=90, plans=6, missed_ticks=0
)


@dataclass(frozen=True)
class Kind:
    """A database: its URL, and a way to lock its events for others."""

    url: str | None
    folder: Path

    def open(self) -> Store:
        return open_store(self.folder, self.url)

    @contextmanager
    def locked(self) -> Iterator[Callable[[], None]]:
        """Within it, until what is given is called, nobody else can write."""
        if self.url is None:
            with closing(sqlite3.connect(self.folder / "motionloop.sqlite", isolation_level=None)) as other:
                other.execute("BEGIN EXCLUSIVE")
                yield lambda: other.execute("COMMIT") and None
        else:
            with psycopg.connect(self.url) as connection:
                connection.execute("LOCK TABLE events IN ACCESS EXCLUSIVE MODE")
                yield connection.commit


@pytest.fixture(scope="module")
def server() -> Iterator[PostgresServer]:
    found = programs()
    if found is None:
        pytest.skip("PostgreSQL is not installed (Debian: apt-get install postgresql)")
    with PostgresServer(found) as running:
        yield running


@pytest.fixture(params=["sqlite", "postgres"])
def kind(request: pytest.FixtureRequest, tmp_path: Path) -> Kind:
    if request.param == "sqlite":
        return Kind(None, tmp_path)
    server: PostgresServer = request.getfixturevalue("server")
    return Kind(server.new_database(), tmp_path)


def event(seq: int) -> Event:
    return Event(seq=seq, type="x", tick=3, unix_s=1.7e9 + 0.123456, data={"after": "ruhig, Übermut \0"})


def _run_and_die(kind: Kind) -> None:
    store = kind.open()
    store.episode_started("e1", SPEC, {})
    store.character_started("c1", {"scene": "flat"})
    store.event("e1", event(1))
    files = RecordingFiles(store.recordings)
    files.add_part("e1", Recording.of(ticks(0, 40)))
    files.add_part("e1", Recording.of(ticks(40, 20)))
    store.flush(60.0)
    os.kill(os.getpid(), signal.SIGKILL)


def test_after_a_kill_running_episodes_are_interrupted_with_all_recorded_ticks(kind: Kind) -> None:
    child = multiprocessing.get_context("spawn").Process(target=_run_and_die, args=(kind,))
    child.start()
    child.join(150)
    assert child.exitcode == -signal.SIGKILL
    store = kind.open()
    episodes, characters = store.left_running()
    assert (episodes, characters) == (["e1"], ["c1"])
    store.mark_interrupted(episodes, characters)
    assert store.left_running() == ([], [])
    row = store.episode("e1")
    assert row["status"] == "interrupted" and row["spec"] == SPEC.model_dump(mode="json")
    assert store.events("e1") == [event(1)]
    files = RecordingFiles(store.recordings)
    assert files.unfinished() == ["e1"]
    files.finish("e1")
    assert len(files.load("e1")) == 60
    assert files.unfinished() == []
    store.close()


def test_episodes_are_filtered_paged_and_deleted(kind: Kind) -> None:
    store = kind.open()
    for i in range(5):
        store.episode_started(f"e{i}", SPEC, {"planner": "stand"})
        if i % 2:
            store.episode_ended(f"e{i}", OUTCOME)
            store.episode_ended(f"e{i}", OUTCOME)  # told again: it is the same
    rows, total = store.episodes("finished", 1, 0)
    assert total == 2
    assert [row["id"] for row in rows] == ["e3"]
    assert rows[0]["outcome"] == OUTCOME.model_dump(mode="json")
    assert rows[0]["services"] == {"planner": "stand"}
    assert [row["id"] for row in store.episodes(None, 2, 3)[0]] == ["e1", "e0"]
    store.delete_episode("e3")
    with pytest.raises(NotFoundError, match="e3"):
        store.episode("e3")
    assert store.failed_writes == 0
    store.close()


def test_events_come_once_and_in_order(kind: Kind) -> None:
    store = kind.open()
    for seq in (2, 1, 3, 2):
        store.event("e", event(seq))
    store.event("other", event(1))
    assert store.events("e") == [event(1), event(2), event(3)]
    assert store.events("e", since=2) == [event(3)]
    store.close()


def test_a_write_that_is_refused_for_good_costs_no_other(kind: Kind) -> None:
    store = kind.open()
    store.event("e", event(1))
    store.event("e", event(2).model_copy(update={"seq": None}))
    store.event("e", event(3))
    assert [each.seq for each in store.events("e")] == [1, 3]
    assert store.failed_writes >= 1
    store.close()


def test_a_locked_store_loses_nothing(kind: Kind) -> None:
    store = kind.open()
    store.flush()
    with kind.locked() as unlock:
        store.event("e", event(1))
        assert not store.flush(0.2)
        unlock()
    assert [each.seq for each in store.events("e")] == [1]
    store.close()


def test_a_locked_store_holds_up_nobody_but_those_who_ask_it(kind: Kind) -> None:
    """Notes are taken at once, readers wait beside the event loop, and other threads' work goes on meanwhile."""
    store = kind.open()
    store.flush()

    async def run(unlock: Callable[[], None]) -> list[int]:
        reader = StoreReader(store)
        store.event("e", event(1))
        asked = [asyncio.create_task(reader.events("e")) for _ in range(20)]  # far more than there are threads
        for turn in range(10):
            await asyncio.sleep(0)
            store.event("e", event(turn + 2))
            await asyncio.to_thread(RecordingFiles(store.recordings).add_part, "e", Recording.of(ticks(turn, 1)))
        assert not any(task.done() for task in asked)
        unlock()
        found = await asyncio.gather(*asked)
        await reader.close()
        return [each.seq for each in found[-1]]

    with kind.locked() as unlock:
        assert asyncio.run(run(unlock)) == list(range(1, 12))


def test_a_server_that_is_away_for_a_while_loses_nothing(server: PostgresServer, tmp_path: Path) -> None:
    store = open_store(tmp_path, server.new_database())
    store.event("e", event(1))
    assert [each.seq for each in store.events("e")] == [1]
    server.stop()
    try:
        store.event("e", event(2))
        assert not store.flush(0.2)
        with pytest.raises(RefusedError, match="cannot be used at the moment"):
            store.events("e")
    finally:
        server.start()
    assert store.flush(100.0)
    assert [each.seq for each in store.events("e")] == [1, 2]
    assert store.failed_writes >= 1
    store.close()


def test_one_orchestrator_uses_a_database(
    server: PostgresServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("orchestrator.store.postgres.HANDOVER_S", 0.0)
    url = server.new_database()
    first = open_store(tmp_path, url)
    with pytest.raises(ConflictError, match="in use by another orchestrator"):
        open_store(tmp_path / "another", url)
    first.close()
    monkeypatch.undo()  # the server notices a moment later that the first is gone
    open_store(tmp_path / "another", url).close()


def test_an_orchestrator_that_is_killed_takes_its_episodes_up_from_postgres(
    server: PostgresServer, tmp_path: Path
) -> None:
    options = replace(light(tmp_path), orchestrator_args=("--store", server.new_database()))
    with Stack(options) as stack, Client(stack.url) as client, kept_up(stack):
        episode_id = client.episode([{"type": "halt", "duration_s": 60}], pacing="realtime").id
        kept = tmp_path / "recordings" / f"{episode_id}.parts" / "resume.state"
        wait_for(kept.is_file, "kept")
        process = stack.orchestrator
        assert process is not None
        os.kill(process.pid, signal.SIGKILL)
        wait_for(lambda: stack.orchestrator is not process and answers(client), "it is back")
        assert first_event(client, episode_id, "resumed").type == "resumed"
        client.episodes[episode_id].cancel()
        assert ended(client, episode_id)["status"] == "cancelled"
    assert not (tmp_path / "motionloop.sqlite").exists()
