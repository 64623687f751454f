"""Messages to multipart frames and back.

A message is N + 2 frames::

    frame 0   8 bytes: "MLP", framing version 1, CRC-32 of frame 1 (little-endian)
    frame 1   JSON: the Envelope's fields, "body" (the message's fields that are no arrays) and
              "arrays": [{"name", "dtype", "shape", "crc32"}, ...]
    frame 2.. the arrays, raw, C order, little-endian, in the order of the table

Counts, sizes, dtypes and shapes are checked against the message type before any array is made. Arrays come back as
read-only views on the received bytes.
"""

from __future__ import annotations

import json
import math
import struct
import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np
from pydantic import ValidationError
from pydantic_core import from_json

from shared.errors import IncompatiblePeerError, InvalidInputError, MalformedMessageError
from shared.protocol.arrays import ArraySpec, array_specs
from shared.protocol.base import PROTOCOL_VERSION, Message
from shared.protocol.control import Envelope
from shared.protocol.errors import invalid_input_from
from shared.protocol.messages import MESSAGES

MAGIC = b"MLP\x01"
MAX_FRAMES = 32
MAX_HEADER_BYTES = 2**20
MAX_MESSAGE_BYTES = 96 * 2**20
UNKNOWN_ID = "unknown-id"

_PREAMBLE = struct.Struct("<4sI")


def encode(envelope: Envelope, message: Message) -> list[bytes]:
    """Frames of a message. Raises InvalidInputError where the body holds what JSON cannot (a non-finite number)."""
    specs = array_specs(type(message))
    table: list[dict[str, Any]] = []
    frames: list[bytes] = []
    for name, spec in specs.items():
        raw = np.ascontiguousarray(getattr(message, name), dtype=np.dtype(spec.dtype))
        data = raw.tobytes()
        table.append({"name": name, "dtype": spec.dtype, "shape": list(raw.shape), "crc32": zlib.crc32(data)})
        frames.append(data)
    header = envelope.model_dump(mode="json", exclude_none=True)
    header["type"] = message.type
    try:
        header["body"] = message.model_dump(mode="json", exclude=set(specs))
        text = json.dumps({**header, "arrays": table}, allow_nan=False, separators=(",", ":")).encode()
    except ValueError as error:
        raise InvalidInputError(f"{message.type} cannot be written as JSON: {error}") from error
    if len(text) > MAX_HEADER_BYTES:
        raise InvalidInputError(
            f"{message.type} has a header of {len(text)} bytes", allowed=f"at most {MAX_HEADER_BYTES} bytes"
        )
    return [_PREAMBLE.pack(MAGIC, zlib.crc32(text)), text, *frames]


def decode(frames: Sequence[bytes]) -> tuple[Envelope, Message]:
    """Envelope and message of received frames.

    Raises:
        MalformedMessageError: the bytes are not a message.
        IncompatiblePeerError: they are one of another protocol version.
        InvalidInputError: they are a message whose values are not allowed; names the field.
    """
    header = _read_header(frames)
    version = header.get("protocol_version")
    if version != PROTOCOL_VERSION:
        raise IncompatiblePeerError(
            f"the peer speaks protocol version {version!r}, this side speaks {PROTOCOL_VERSION}",
            field="protocol_version",
            allowed=str(PROTOCOL_VERSION),
        )
    body, table = header.pop("body", None), header.pop("arrays", None)
    if not isinstance(body, dict) or not isinstance(table, list):
        raise MalformedMessageError("the header lacks a body object or an array table", field="body")
    try:
        envelope = Envelope.model_validate(header)
    except ValidationError as error:
        raise MalformedMessageError(f"bad envelope: {invalid_input_from(error).message}") from error
    message_type = MESSAGES.get(envelope.type)
    if message_type is None:
        raise MalformedMessageError(
            f"unknown message type {envelope.type!r}", field="type", allowed=", ".join(sorted(MESSAGES))
        )
    arrays = _read_arrays(table, frames[2:], array_specs(message_type))
    if clash := arrays.keys() & body.keys():
        raise MalformedMessageError(f"{sorted(clash)} both in the body and among the arrays")
    try:
        return envelope, message_type.model_validate({**body, **arrays})
    except ValidationError as error:
        raise invalid_input_from(error) from error


def message_id_of(frames: Sequence[bytes]) -> str:
    """The message id of frames that `decode` refused, as far as readable, so that the refusal finds its sender."""
    try:
        found = _read_header(frames).get("message_id")
    except MalformedMessageError:
        return UNKNOWN_ID
    return found if isinstance(found, str) and 8 <= len(found) <= 64 else UNKNOWN_ID


def _read_header(frames: Sequence[bytes]) -> dict[str, Any]:
    if not 2 <= len(frames) <= MAX_FRAMES:
        raise MalformedMessageError(f"{len(frames)} frames", allowed=f"2 to {MAX_FRAMES} frames")
    preamble, text = frames[0], frames[1]
    if len(preamble) != _PREAMBLE.size or preamble[:4] != MAGIC:
        raise MalformedMessageError("not a motionloop message: wrong first frame")
    if len(text) > MAX_HEADER_BYTES:
        raise MalformedMessageError(f"header of {len(text)} bytes", allowed=f"at most {MAX_HEADER_BYTES} bytes")
    if sum(len(frame) for frame in frames) > MAX_MESSAGE_BYTES:
        raise MalformedMessageError("message too large", allowed=f"at most {MAX_MESSAGE_BYTES} bytes")
    if _PREAMBLE.unpack(preamble)[1] != zlib.crc32(text):
        raise MalformedMessageError("the header was corrupted on the way")
    try:
        header = from_json(text, allow_inf_nan=False)
    except ValueError as error:
        raise MalformedMessageError(f"the header is not JSON: {error}") from error
    if not isinstance(header, dict):
        raise MalformedMessageError("the header is not a JSON object")
    return header


def _read_arrays(
    table: list[Any], frames: Sequence[bytes], specs: dict[str, ArraySpec]
) -> dict[str, np.ndarray[Any, Any]]:
    if len(table) != len(frames):
        raise MalformedMessageError(f"the array table has {len(table)} rows, but {len(frames)} array frames came")
    arrays: dict[str, np.ndarray[Any, Any]] = {}
    for row, frame in zip(table, frames, strict=True):
        if not isinstance(row, dict) or not isinstance(row.get("name"), str):
            raise MalformedMessageError("a row of the array table has no name", field="arrays")
        name, shape = row["name"], row.get("shape")
        spec = specs.get(name)
        if spec is None or name in arrays:
            raise MalformedMessageError(
                f"unexpected array {name[:64]!r}", field="arrays", allowed=", ".join(specs) or "no arrays"
            )
        if row.get("dtype") != spec.dtype:
            raise InvalidInputError(f"{name} has dtype {row.get('dtype')!r}", field=name, allowed=spec.dtype)
        if not isinstance(shape, list) or len(shape) > 8 or not all(type(n) is int and n >= 0 for n in shape):
            raise MalformedMessageError(f"{name} has no proper shape", field=name)
        spec.check_shape(tuple(shape), name)
        expected = math.prod(shape) * np.dtype(spec.dtype).itemsize
        if len(frame) != expected:
            raise MalformedMessageError(f"{name} is {len(frame)} bytes long, its shape says {expected}", field=name)
        if zlib.crc32(frame) != row.get("crc32"):
            raise MalformedMessageError(f"{name} was corrupted on the way", field=name)
        arrays[name] = np.frombuffer(frame, dtype=np.dtype(spec.dtype)).reshape(shape)
    return arrays
