"""What an episode is taken up from after a restart, as the bytes of one file: .npz, never unpickled."""

from __future__ import annotations

import io
import json
import zipfile

import numpy as np

from orchestrator.core.keepsake import EpisodeState, Keepsake, LoopState, Pace
from shared.errors import InvalidInputError
from shared.protocol.messages import Snapshot


def to_bytes(kept: Keepsake, state: EpisodeState) -> bytes:
    """The character at a tick, and where the episode is."""
    about = {
        "tick": kept.tick,
        "meta": kept.snapshot.meta,
        "loop": kept.loop.model_dump(),
        "pace": kept.pace.model_dump(),
        "episode": state.model_dump(mode="json"),
    }
    out = io.BytesIO()
    np.savez(
        out,
        about=np.array(json.dumps(about)),
        state=kept.snapshot.state,
        buffers=kept.snapshot.buffers,
        planned_w_m=kept.planned_w_m,
    )
    return out.getvalue()


def from_bytes(data: bytes) -> tuple[Keepsake, EpisodeState]:
    """The way back; raises InvalidInputError for a file that is damaged or of another version."""
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            about = json.loads(str(arrays["about"]))
            snapshot = Snapshot(
                tick=about["tick"], meta=about["meta"], state=arrays["state"], buffers=arrays["buffers"]
            )  # fmt: skip
            planned = np.asarray(arrays["planned_w_m"], dtype=np.float64)
        loop, pace = LoopState.model_validate(about["loop"]), Pace.model_validate(about["pace"])
        return Keepsake(snapshot, loop, pace, planned), EpisodeState.model_validate(about["episode"])
    except (ValueError, KeyError, OSError, zipfile.BadZipFile) as error:
        raise InvalidInputError(f"the episode cannot be taken up: {error}", field="resume") from error
