"""Errors as people want to read them, for the modules that are started from a terminal."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from shared.errors import MotionLoopError


def in_words(error: MotionLoopError) -> str:
    """Code, field, message and allowed values of an error, in one or two lines."""
    where = f" in {error.field}" if error.field else ""
    allowed = f"\n  allowed: {error.allowed}" if error.allowed else ""
    return f"{error.code}{where}: {error.message}{allowed}"


@contextmanager
def errors_for_people() -> Iterator[None]:
    """Print our own errors as one clear line without a traceback and end with exit code 1."""
    try:
        yield
    except MotionLoopError as error:
        sys.stderr.write(f"{in_words(error)}\n")
        raise SystemExit(1) from error
