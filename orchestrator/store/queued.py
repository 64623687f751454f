"""What survives a restart, in the tables of an SQL database: characters, episodes, events and results.

One thread writes, fed by a queue, so that a slow or full disk never holds up the loop; what could not be written stays
queued and is tried again. Which database it is says a `Database`; the SQL here is understood by SQLite and PostgreSQL.
"""

from __future__ import annotations

import json
import logging
import queue
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

from orchestrator.core.episode_spec import EpisodeOutcome, EpisodeSpec
from orchestrator.rest import Event
from shared.errors import MotionLoopError, NotFoundError, UnavailableError

log = logging.getLogger(__name__)

TABLES = (
    """CREATE TABLE IF NOT EXISTS characters (
    id TEXT PRIMARY KEY, spec TEXT NOT NULL, status TEXT NOT NULL, created_s DOUBLE PRECISION NOT NULL,
    ended_s DOUBLE PRECISION)""",
    """CREATE TABLE IF NOT EXISTS episodes (
    id TEXT PRIMARY KEY, spec TEXT NOT NULL, status TEXT NOT NULL, reason TEXT, outcome TEXT, services TEXT,
    created_s DOUBLE PRECISION NOT NULL, ended_s DOUBLE PRECISION)""",
    "CREATE INDEX IF NOT EXISTS episodes_by_time ON episodes (created_s, id)",
    """CREATE TABLE IF NOT EXISTS events (
    owner TEXT NOT NULL, seq INTEGER NOT NULL, type TEXT NOT NULL, tick INTEGER NOT NULL,
    unix_s DOUBLE PRECISION NOT NULL, data TEXT NOT NULL, PRIMARY KEY (owner, seq))""",
    """CREATE TABLE IF NOT EXISTS results (
    episode TEXT NOT NULL, task INTEGER NOT NULL, type TEXT NOT NULL, success_strict INTEGER NOT NULL,
    result TEXT NOT NULL, PRIMARY KEY (episode, task))""",
)

QUEUED_WRITES = 100_000
RETRY_S = 0.5
Write = tuple[str, Sequence[Any]]
"""A statement and its values, `?` where they go."""


class RefusedError(UnavailableError):
    """The database is locked, full or away; what it was asked may do later."""


class Database(Protocol):
    """A database; all of its methods raise RefusedError where it may do later, and MotionLoopError where it never will.

    `write` is called by one thread, `read` by many.
    """

    def prepare(self, statements: Sequence[str]) -> None:
        """Make the tables."""
        ...

    def write(self, batch: Sequence[Write]) -> None:
        """All of it, or nothing."""
        ...

    def read(self, statement: str, values: Sequence[Any]) -> list[dict[str, Any]]:
        """The rows."""
        ...

    def close(self) -> None:
        """Let go of every connection."""
        ...


class SqlStore:
    """The tables and the queue before them (see `store.interface.Store`).

    Args:
        folder: made if needed; holds `recordings/`, which are files whatever the database is.
        database: where the tables are.

    Raises RefusedError where the tables cannot be made.
    """

    def __init__(self, folder: Path, database: Database):
        self.folder = folder
        self.recordings = folder / "recordings"
        self.recordings.mkdir(parents=True, exist_ok=True)
        self._database = database
        database.prepare(TABLES)
        self._queue: queue.Queue[Write | threading.Event | None] = queue.Queue(QUEUED_WRITES)
        self.failed_writes = 0
        self._thread = threading.Thread(target=self._write_all, name="store", daemon=True)
        self._thread.start()

    # --- writing ---

    def character_started(self, character_id: str, spec: dict[str, Any]) -> None:
        """Note a new character."""
        self._put(
            "INSERT INTO characters VALUES (?, ?, 'running', ?, NULL) ON CONFLICT (id) DO NOTHING",
            (character_id, json.dumps(spec), time.time()),
        )

    def character_ended(self, character_id: str, status: str) -> None:
        """Note its end."""
        self._put("UPDATE characters SET status = ?, ended_s = ? WHERE id = ?", (status, time.time(), character_id))

    def episode_started(self, episode_id: str, spec: EpisodeSpec, services: dict[str, Any]) -> None:
        """Note a running episode and what it runs on."""
        self._put(
            "INSERT INTO episodes VALUES (?, ?, 'running', NULL, NULL, ?, ?, NULL) ON CONFLICT (id) DO NOTHING",
            (episode_id, spec.model_dump_json(), json.dumps(services), time.time()),
        )

    def episode_ended(self, episode_id: str, outcome: EpisodeOutcome) -> None:
        """Note its outcome and results."""
        for result in outcome.results:
            self._put(
                "INSERT INTO results VALUES (?, ?, ?, ?, ?) ON CONFLICT (episode, task) DO UPDATE SET "
                "type = excluded.type, success_strict = excluded.success_strict, result = excluded.result",
                (episode_id, result.index, result.type, int(result.success_strict), result.model_dump_json()),
            )
        self._put(
            "UPDATE episodes SET status = ?, reason = ?, outcome = ?, ended_s = ? WHERE id = ?",
            (outcome.status, outcome.reason, outcome.model_dump_json(), time.time(), episode_id),
        )

    def event(self, owner: str, event: Event) -> None:
        """Keep an event of a character or episode."""
        row = (owner, event.seq, event.type, event.tick, event.unix_s, json.dumps(event.data))
        self._put("INSERT INTO events VALUES (?, ?, ?, ?, ?, ?) ON CONFLICT (owner, seq) DO NOTHING", row)

    def delete_episode(self, episode_id: str) -> None:
        """Remove an episode and all that belongs to it."""
        self._put("DELETE FROM events WHERE owner = ?", (episode_id,))
        self._put("DELETE FROM results WHERE episode = ?", (episode_id,))
        self._put("DELETE FROM episodes WHERE id = ?", (episode_id,))

    def left_running(self) -> tuple[list[str], list[str]]:
        """On start: the episodes and the characters that a process which is no more was running."""
        self.flush()
        episodes = self._read("SELECT id FROM episodes WHERE status = 'running'")
        characters = self._read("SELECT id FROM characters WHERE status = 'running'")
        return [row["id"] for row in episodes], [row["id"] for row in characters]

    def mark_interrupted(self, episodes: Sequence[str], characters: Sequence[str]) -> None:
        """Those that do not go on are interrupted."""
        now = time.time()
        for episode_id in episodes:
            self._put(
                "UPDATE episodes SET status = 'interrupted', reason = ?, ended_s = ? WHERE id = ?",
                ("the orchestrator was stopped in mid-episode", now, episode_id),
            )
        for character_id in characters:
            self.character_ended(character_id, "interrupted")
        self.flush()

    def flush(self, timeout_s: float = 10.0) -> bool:
        """Wait until everything queued so far is on disk; False when that took too long."""
        done = threading.Event()
        self._queue.put(done)
        return done.wait(timeout_s)

    def close(self) -> None:
        """Write what is queued and end the thread (gives up after a while when the disk refuses)."""
        self._queue.put(None)
        self._thread.join(10.0)
        self._database.close()

    # --- reading ---

    def episode(self, episode_id: str) -> dict[str, Any]:
        """One episode's row; raises NotFoundError."""
        self.flush()
        rows = self._read("SELECT * FROM episodes WHERE id = ?", (episode_id,))
        if not rows:
            raise NotFoundError(f"there is no episode {episode_id}", field="id")
        return _decoded(rows[0])

    def episodes(self, status: str | None, limit: int, offset: int) -> tuple[list[dict[str, Any]], int]:
        """Newest first; and how many there are in all."""
        self.flush()
        where, values = ("WHERE status = ?", (status,)) if status else ("", ())
        total = int(self._read(f"SELECT COUNT(*) AS total FROM episodes {where}", values)[0]["total"])
        rows = self._read(
            f"SELECT * FROM episodes {where} ORDER BY created_s DESC, id LIMIT ? OFFSET ?", (*values, limit, offset)
        )
        return [_decoded(row) for row in rows], total

    def events(self, owner: str, since: int = 0) -> list[Event]:
        """Events of a character or episode after number `since`."""
        self.flush()
        rows = self._read("SELECT * FROM events WHERE owner = ? AND seq > ? ORDER BY seq", (owner, since))
        return [
            Event(seq=r["seq"], type=r["type"], tick=r["tick"], unix_s=r["unix_s"], data=json.loads(r["data"]))
            for r in rows
        ]

    # --- inside ---

    def _read(self, statement: str, values: Sequence[Any] = ()) -> list[dict[str, Any]]:
        return self._database.read(statement, values)

    def _put(self, sql: str, values: Sequence[Any]) -> None:
        try:
            self._queue.put_nowait((sql, values))
        except queue.Full:
            self.failed_writes += 1
            log.error("the store is stuck: a write was lost")

    def _write_all(self) -> None:
        ended = False
        while not ended:
            batch, flushed, ended = self._drain()
            self._commit(batch)
            for event in flushed:
                event.set()

    def _drain(self) -> tuple[list[Write], list[threading.Event], bool]:
        batch: list[Write] = []
        flushed: list[threading.Event] = []
        item = self._queue.get()
        while True:
            if item is None:
                return batch, flushed, True
            if isinstance(item, threading.Event):
                flushed.append(item)
            else:
                batch.append(item)
            try:
                item = self._queue.get_nowait()
            except queue.Empty:
                return batch, flushed, False

    def _commit(self, batch: list[Write]) -> None:
        while batch:
            try:
                self._database.write(batch)
                return
            except RefusedError as error:  # locked, full or away: nothing is lost, it is tried again
                self.failed_writes += 1
                log.warning("the store could not be written: %s", error.message)
                time.sleep(RETRY_S)
            except MotionLoopError as error:
                self.failed_writes += 1
                if len(batch) == 1:
                    log.error("the store takes no %r: %s", batch[0][0].split(" VALUES", 1)[0], error.message)
                    return
                for one in batch:  # the others are not to be lost for it
                    self._commit([one])
                return


def _decoded(row: dict[str, Any]) -> dict[str, Any]:
    out = dict(row)
    for name in ("spec", "outcome", "services"):
        if out.get(name):
            out[name] = json.loads(out[name])
    return out
