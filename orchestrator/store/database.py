"""The store in one SQLite file (WAL)."""

from __future__ import annotations

import sqlite3
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from orchestrator.store.queued import RefusedError, SqlStore, Write
from shared.errors import InvalidInputError, MotionLoopError

PATIENCE_S = 5.0
"""So long a locked file is waited for at a time."""


class SqliteDatabase:
    """See `store.queued.Database`. Readers use connections of their own."""

    def __init__(self, path: Path):
        self._path = path
        self._writer: sqlite3.Connection | None = None

    def prepare(self, statements: Sequence[str]) -> None:
        """Make file and tables."""
        try:
            with closing(sqlite3.connect(self._path, timeout=2 * PATIENCE_S)) as connection, connection:
                connection.execute("PRAGMA journal_mode=WAL")
                for statement in statements:
                    connection.execute(statement)
        except sqlite3.Error as error:
            raise _ours(error) from error

    def write(self, batch: Sequence[Write]) -> None:
        """All of it, or nothing."""
        try:
            if self._writer is None:
                self._writer = sqlite3.connect(self._path, timeout=PATIENCE_S, check_same_thread=False)
                self._writer.execute("PRAGMA synchronous=NORMAL")
            with self._writer as connection:
                for statement, values in batch:
                    connection.execute(statement, values)
        except sqlite3.Error as error:
            raise _ours(error) from error

    def read(self, statement: str, values: Sequence[Any]) -> list[dict[str, Any]]:
        """The rows."""
        try:
            with closing(sqlite3.connect(self._path, timeout=2 * PATIENCE_S)) as connection:
                connection.row_factory = sqlite3.Row
                return [dict(row) for row in connection.execute(statement, values)]
        except sqlite3.Error as error:
            raise _ours(error) from error

    def close(self) -> None:
        """Let go of the writer's connection."""
        if self._writer is not None:
            self._writer.close()
            self._writer = None


def _ours(error: sqlite3.Error) -> MotionLoopError:
    if isinstance(error, sqlite3.OperationalError):
        return RefusedError(f"the store cannot be used at the moment: {error}")
    return InvalidInputError(f"the store refuses what it was asked: {error}", field="store")


class SqliteStore(SqlStore):
    """What survives a restart, in one SQLite file.

    Args:
        folder: made if needed; holds `motionloop.sqlite` and `recordings/`.
    """

    def __init__(self, folder: Path):
        folder.mkdir(parents=True, exist_ok=True)
        super().__init__(folder, SqliteDatabase(folder / "motionloop.sqlite"))
