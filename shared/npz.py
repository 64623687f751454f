"""Reading .npz bytes that came from somewhere else: nothing larger than a limit is unpacked, nothing is unpickled."""

from __future__ import annotations

import io
import math
import tokenize
import zipfile
import zlib
from collections.abc import Collection
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.lib import format as npy

from shared.errors import InvalidInputError

Arrays = dict[str, np.ndarray]
SNAPSHOT_BYTES = 32 * 2**20
"""The most that a part of a snapshot may unpack to; on the wire it is at most 8 MB, and not compressed."""

_DAMAGED = (
    zipfile.BadZipFile, zlib.error, tokenize.TokenError, SyntaxError, OSError, EOFError, ValueError,
    RuntimeError, MemoryError,
)  # fmt: skip
"""What zipfile and numpy raise for bytes that are not theirs; each is told as InvalidInputError.

RuntimeError: an encrypted member, or an unknown compression; MemoryError: a size beyond all memory;
SyntaxError and TokenError: a header, which numpy reads as Python's literals."""


def read_npz(data: bytes, limit_bytes: int) -> Arrays:
    """The arrays of an .npz by name.

    What is said of sizes is checked before anything is unpacked: of the archive's members against the limit, of the
    arrays against their members. So neither a small archive of many zeros nor a small array of a huge shape takes
    memory.

    Args:
        limit_bytes: of all members, unpacked.

    Raises:
        InvalidInputError: these are no such bytes, or they are too much.
    """
    try:
        return _read(io.BytesIO(data), None, limit_bytes)[1]
    except _DAMAGED as error:
        raise InvalidInputError(f"these are no arrays: {error}") from error


def read_npz_file(path: Path, wanted: Collection[str], limit_bytes: int) -> tuple[list[str], Arrays]:
    """Names of all arrays of an .npz file, and those that are `wanted` and there; the others are not looked into.

    Args:
        limit_bytes: of the wanted ones, unpacked.

    Raises:
        InvalidInputError: it is no such file, or the arrays are too much. Its message is the reason alone.
    """
    try:
        with path.open("rb") as stream:
            return _read(stream, wanted, limit_bytes)
    except _DAMAGED as error:
        raise InvalidInputError(str(error) or type(error).__name__, field="path") from error


def _read(stream: BinaryIO, wanted: Collection[str] | None, limit_bytes: int) -> tuple[list[str], Arrays]:
    with zipfile.ZipFile(stream) as archive:
        members = {member.filename.removesuffix(".npy"): member for member in archive.infolist()}
        names = list(members)
        members = {name: member for name, member in members.items() if wanted is None or name in wanted}
        whole = sum(member.file_size for member in members.values())
        if whole > limit_bytes:
            raise InvalidInputError(f"the arrays have {whole} bytes", allowed=f"at most {limit_bytes} bytes")
        return names, {name: _array(archive.read(member), name) for name, member in members.items()}


def _array(data: bytes, name: str) -> np.ndarray:
    stream = io.BytesIO(data)
    read_header = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}.get(npy.read_magic(stream))
    if read_header is None:
        raise ValueError(f"{name} has an unknown format")
    shape, fortran, dtype = read_header(stream)
    if dtype.hasobject:
        raise ValueError(f"{name} holds objects")
    raw = data[stream.tell() :]
    if len(raw) != math.prod(shape) * dtype.itemsize:
        raise ValueError(f"{name} has {len(raw)} bytes, its shape says {math.prod(shape) * dtype.itemsize}")
    return np.frombuffer(bytearray(raw), dtype).reshape(shape, order="F" if fortran else "C")
