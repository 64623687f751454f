"""The last seconds of a character's log inside a snapshot: in front of the simulation's own bytes."""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from shared.errors import InvalidInputError
from shared.npz import SNAPSHOT_BYTES, read_npz
from shared.protocol.base import PROTOCOL_VERSION
from tracker_service.simulation.recorder import Samples


def pack_tail(samples: Samples) -> npt.NDArray[np.uint8]:
    """The samples as bytes."""
    out = io.BytesIO()
    np.savez(out, **samples)  # type: ignore[arg-type]
    return np.frombuffer(out.getvalue(), dtype=np.uint8)


def check_format(meta: Mapping[str, Any]) -> None:
    """Raise InvalidInputError for a snapshot that another protocol version's tracker took."""
    made_by = meta.get("format", 1)
    if made_by != PROTOCOL_VERSION:
        raise InvalidInputError(
            f"the snapshot has format {made_by!r}, it was taken by a tracker of that protocol version",
            field="meta.format",
            allowed=str(PROTOCOL_VERSION),
        )


def split_buffers(meta: Mapping[str, Any], buffers: npt.NDArray[np.uint8]) -> tuple[Samples, npt.NDArray[np.uint8]]:
    """The tail of the log and the simulation's own part; raises InvalidInputError for a damaged snapshot."""
    try:
        size = int(meta["tail_bytes"])
        int(meta["first_sample"]), int(meta["seed"])
        tail: Samples = read_npz(buffers[:size].tobytes(), SNAPSHOT_BYTES)
        if "fallen" not in tail:
            raise ValueError("the log is missing")
    except (InvalidInputError, KeyError, ValueError, TypeError, OverflowError) as error:
        raise InvalidInputError(f"the snapshot is damaged: {error}", field="buffers") from error
    return tail, buffers[size:]
