"""The last sound state of a character whose physics failed, written for replay."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

State = tuple[Mapping[str, Any], npt.NDArray[np.float64], npt.NDArray[np.uint8]]


def dump_state(folder: Path, character_id: str, state: State, failed_tick: int, reason: str) -> str:
    """Write a snapshot of the simulation; the file's path, or why it was not written."""
    meta, physics, buffers = state
    name = "".join(c if c.isalnum() or c in "-_" else "_" for c in character_id) or "character"
    path = folder / f"{name}-{failed_tick}.npz"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        about = json.dumps({**meta, "failed_tick": failed_tick, "reason": reason})
        np.savez(path, state=physics, buffers=buffers, about=np.array(about))
    except OSError as problem:
        return f"not dumped: {problem}"
    return str(path)
