"""Numbers for browsers: a JSON header and float32 arrays in one block of bytes, read without a parser for .npz.

Layout, little-endian: uint32 length of the header; the header, UTF-8 JSON padded with spaces so that the numbers begin
at a multiple of four bytes; then every array named in the header's `arrays` ([{"name", "shape"}, ...]) as float32 in C
order, one after another.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from math import prod
from typing import Any

import numpy as np
import numpy.typing as npt

from shared.errors import MalformedMessageError

MEDIA_TYPE = "application/octet-stream"


def pack(header: Mapping[str, Any], arrays: Mapping[str, npt.ArrayLike]) -> bytes:
    """The block of a header (anything JSON can hold) and named arrays of any shape."""
    blocks = {name: np.asarray(array, dtype="<f4", order="C") for name, array in arrays.items()}
    table = [{"name": name, "shape": list(block.shape)} for name, block in blocks.items()]
    text = json.dumps({**header, "arrays": table}, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    return b"".join([len(text).to_bytes(4, "little"), text, *(block.tobytes() for block in blocks.values())])


def unpack(data: bytes) -> tuple[dict[str, Any], dict[str, npt.NDArray[np.float32]]]:
    """Header and arrays of a block; raises MalformedMessageError when the lengths do not agree."""
    length = int.from_bytes(data[:4], "little")
    if len(data) < 4 + length:
        raise MalformedMessageError(f"a block of {len(data)} bytes has a header of {length}")
    header: dict[str, Any] = json.loads(data[4 : 4 + length])
    arrays: dict[str, npt.NDArray[np.float32]] = {}
    place = 4 + length
    for entry in header.pop("arrays"):
        shape = tuple(int(size) for size in entry["shape"])
        size = 4 * prod(shape)
        if len(data) < place + size:
            raise MalformedMessageError(f"array {entry['name']!r} is cut off", field=str(entry["name"]))
        arrays[str(entry["name"])] = np.frombuffer(data, "<f4", prod(shape), place).reshape(shape)
        place += size
    return header, arrays
