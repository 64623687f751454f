"""Errors as people want to read them: the one place that turns what is expected to go wrong into a sentence."""

from __future__ import annotations

import errno
import lzma
import sys
import tarfile
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from json import JSONDecodeError
from pathlib import Path

from pydantic import ValidationError

from shared.errors import InvalidInputError, MotionLoopError

EXPECTED = (
    MotionLoopError, OSError, UnicodeError, EOFError, JSONDecodeError, ValidationError, zipfile.BadZipFile, zlib.error,
    lzma.LZMAError, tarfile.TarError,
)  # fmt: skip
"""What files, folders, archives and people's input do at times; anything else is a fault of the program."""

_OF_PATHS = {
    errno.ENOENT: "there is no such file or folder",
    errno.EEXIST: "there is a file where a folder is needed",
    errno.ENOTDIR: "a part of the path is a file, not a folder",
    errno.EISDIR: "it is a folder where a file is needed",
    errno.EACCES: "permission denied",
    errno.EPERM: "permission denied",
    errno.EROFS: "it cannot be written: the file system is read-only",
    errno.ENOSPC: "the disk is full",
    errno.ENAMETOOLONG: "the name is too long",
    errno.ENOTEMPTY: "the folder is not empty",
}


def as_ours(error: BaseException) -> MotionLoopError:
    """An expected error as one of our own, whose message is a sentence."""
    if isinstance(error, MotionLoopError):
        return error
    if isinstance(error, OSError):
        what = _OF_PATHS.get(error.errno or 0, error.strerror or str(error) or type(error).__name__)
        where = f"{error.filename}: " if error.filename is not None else ""
        return InvalidInputError(f"{where}{what}")
    if isinstance(error, ValidationError):
        first = error.errors()[0]
        field = ".".join(str(part) for part in first["loc"]) or None
        return InvalidInputError(str(first["msg"]), field=field)
    if isinstance(error, UnicodeError):
        return InvalidInputError(f"text that cannot be decoded ({error})")
    if isinstance(error, JSONDecodeError):
        return InvalidInputError(f"not JSON ({error})")
    return InvalidInputError(f"a file that is cut off or broken ({error})")


def in_words(error: BaseException) -> str:
    """Code, field, message and allowed values of an error, in one or two lines."""
    ours = as_ours(error)
    where = f" in {ours.field}" if ours.field else ""
    allowed = f"\n  allowed: {ours.allowed}" if ours.allowed else ""
    return f"{ours.code}{where}: {' '.join(ours.message.split())}{allowed}"


@contextmanager
def errors_for_people() -> Iterator[None]:
    """Print what is expected to go wrong as one clear line without a traceback and end with exit code 1."""
    try:
        yield
    except BrokenPipeError as error:
        raise SystemExit(1) from error  # whoever read the output has gone: nobody is there to be told
    except EXPECTED as error:
        sys.stderr.write(f"{in_words(error)}\n")
        raise SystemExit(1) from error


def check_output_file(path: Path | None) -> None:
    """Make sure, before long work, that a result can be written to `path`; its folder is made.

    Raises:
        InvalidInputError: it is a folder, or its folder cannot be made.
    """
    if path is None:
        return
    if path.is_dir():
        raise InvalidInputError(f"{path}: it is a folder where a file is needed")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise as_ours(error) from error
