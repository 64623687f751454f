"""The store in a PostgreSQL database (extra `postgres`)."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import psycopg
from psycopg.rows import DictRow, dict_row

from orchestrator.store.queued import RefusedError, SqlStore, Write
from shared.errors import ConflictError, InvalidInputError, MotionLoopError

CONNECT_S = 5
SILENCE_MS = 5000
"""A server that does not answer for so long is left, and asked again later."""
LOCK = 0x6D6F74696F6E6C70
"""Of the one orchestrator that uses a database; in letters `motionlp`."""
HANDOVER_S = 10.0
"""A server notices within moments that the process which held the lock has ended."""


class PostgresDatabase:
    """See `store.queued.Database`.

    One orchestrator uses a database: two would each take the other's running episodes for left over. The connection
    that writes holds a lock for that; each thread that reads has a connection of its own.

    Args:
        url: postgresql://user:password@host/database.
    """

    def __init__(self, url: str):
        self._url = url
        self._writer: psycopg.Connection[DictRow] | None = None
        self._readers = threading.local()
        self._open: set[psycopg.Connection[DictRow]] = set()
        self._guard = threading.Lock()

    def prepare(self, statements: Sequence[str]) -> None:
        """Make the tables. Raises ConflictError where another orchestrator uses the database."""
        try:
            writer = self._writing(HANDOVER_S)
            with writer.transaction():
                for statement in statements:
                    writer.execute(statement.encode())
        except psycopg.Error as error:
            raise self._given_up(error) from error

    def write(self, batch: Sequence[Write]) -> None:
        """All of it, or nothing."""
        try:
            writer = self._writing(0.0)
            with writer.transaction():
                for statement, values in batch:
                    writer.execute(_sql(statement), values)
        except ConflictError as error:
            raise RefusedError(error.message) from error
        except psycopg.Error as error:
            raise self._given_up(error) from error

    def read(self, statement: str, values: Sequence[Any]) -> list[dict[str, Any]]:
        """The rows."""
        reader: psycopg.Connection[DictRow] | None = getattr(self._readers, "connection", None)
        try:
            if reader is None or reader.closed:
                reader = self._readers.connection = self._connect()
            return reader.execute(_sql(statement), values).fetchall()
        except psycopg.Error as error:
            self._forget(reader)
            self._readers.connection = None
            raise _ours(error) from error

    def close(self) -> None:
        """Let go of every connection."""
        with self._guard:
            opened, self._open = self._open, set()
        for connection in opened:
            connection.close()
        self._writer = None

    def _writing(self, patience_s: float) -> psycopg.Connection[DictRow]:
        if self._writer is None or self._writer.closed:
            self._writer = self._locked(patience_s)
        return self._writer

    def _locked(self, patience_s: float) -> psycopg.Connection[DictRow]:
        connection, until = self._connect(), time.monotonic() + patience_s
        while True:
            row = connection.execute("SELECT pg_try_advisory_lock(%s) AS mine", (LOCK,)).fetchone()
            if row is not None and row["mine"]:
                return connection
            if time.monotonic() >= until:
                self._forget(connection)
                raise ConflictError(
                    "the database is in use by another orchestrator: end that one, or give this one a database of its "
                    "own with --store",
                    field="store",
                )
            time.sleep(0.2)

    def _connect(self) -> psycopg.Connection[DictRow]:
        connection = psycopg.connect(
            self._url,
            autocommit=True,
            row_factory=dict_row,
            connect_timeout=CONNECT_S,
            tcp_user_timeout=SILENCE_MS,
            options=f"-c statement_timeout={SILENCE_MS}",
            application_name="motionloop",
        )
        with self._guard:
            self._open.add(connection)
        return connection

    def _given_up(self, error: psycopg.Error) -> MotionLoopError:
        """A connection that has failed is not used again."""
        if isinstance(error, psycopg.OperationalError):
            self._forget(self._writer)
            self._writer = None
        return _ours(error)

    def _forget(self, connection: psycopg.Connection[DictRow] | None) -> None:
        if connection is not None:
            with self._guard:
                self._open.discard(connection)
            connection.close()


def _sql(statement: str) -> bytes:
    return statement.replace("?", "%s").encode()


def _ours(error: psycopg.Error) -> MotionLoopError:
    if isinstance(error, psycopg.OperationalError):
        return RefusedError(f"the database cannot be used at the moment: {error}".strip())
    return InvalidInputError(f"the database refuses what it was asked: {error}".strip(), field="store")


class PostgresStore(SqlStore):
    """What survives a restart, in a PostgreSQL database; recordings are files of the data folder all the same.

    Args:
        folder: made if needed; holds `recordings/`.
        url: postgresql://user:password@host/database.
    """

    def __init__(self, folder: Path, url: str):
        super().__init__(folder, PostgresDatabase(url))
