"""One server a data folder: two would each take the other's running episodes for left over."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path
from types import TracebackType
from typing import Self

from shared.errors import ConflictError

NAME = "in_use_by"


class FolderLock:
    """Holds a data folder from `acquire` until `release`, or until the process ends in whatever way.

    Args:
        folder: made if needed.
    """

    def __init__(self, folder: Path):
        self._folder = folder
        self._handle: int | None = None

    def acquire(self) -> FolderLock:
        """Take it. Raises ConflictError, which names the process that has it, at once."""
        self._folder.mkdir(parents=True, exist_ok=True)
        handle = os.open(self._folder / NAME, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            owner = os.read(handle, 64).decode(errors="replace").strip()
            os.close(handle)
            raise ConflictError(
                f"the data folder {self._folder} is in use by another server"
                + (f" (process {owner})" if owner else "")
                + ": end that one, or give this one a folder of its own with --data-dir",
                field="data_dir",
            ) from error
        os.ftruncate(handle, 0)
        os.pwrite(handle, f"{os.getpid()}\n".encode(), 0)
        self._handle = handle
        return self

    def release(self) -> None:
        """Let it go. Safe to call twice."""
        if self._handle is not None:
            os.close(self._handle)
            self._handle = None

    def __enter__(self) -> Self:
        self.acquire()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()


def check_free(folder: Path) -> None:
    """Raise ConflictError where another server has the folder; for telling so before anything is started."""
    with FolderLock(folder):
        return
