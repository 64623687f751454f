"""Which store a server uses."""

from __future__ import annotations

from pathlib import Path

from orchestrator.store.database import SqliteStore
from orchestrator.store.queued import SqlStore
from shared.errors import InvalidInputError

POSTGRES = ("postgresql://", "postgres://")


def open_store(folder: Path, url: str | None) -> SqlStore:
    """SQLite in the data folder, or the PostgreSQL database of a URL.

    Raises:
        InvalidInputError: the extra `postgres` is not installed, or the database refuses.
        RefusedError: the database is not there.
        ConflictError: another orchestrator uses it.
    """
    if url is None:
        return SqliteStore(folder)
    try:
        from orchestrator.store.postgres import PostgresStore
    except ImportError as error:
        raise InvalidInputError(
            "a PostgreSQL store needs psycopg: pip install 'motionloop[postgres]'", field="store"
        ) from error
    return PostgresStore(folder, url)
