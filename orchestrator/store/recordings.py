"""Recordings: one .npz an episode, written atomically, gathered in parts while it runs so that a kill loses little."""

from __future__ import annotations

import io
import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from shared.errors import NotFoundError
from shared.motion.skeleton import CANONICAL
from shared.protocol.messages import TICK_HZ, TickRange

FIELDS = (
    "body_pos_w_m",
    "body_quat_w",
    "body_linvel_w_mps",
    "contacts",
    "object_pose_w",
    "tracking_error_m",
    "fallen",
    "reference_pos_w_m",
)


@dataclass(frozen=True)
class Recording:
    """Control ticks start_tick.. at 30 Hz; arrays as in `TickRange`."""

    start_tick: int
    arrays: dict[str, npt.NDArray[np.generic]]
    objects: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.arrays["body_pos_w_m"])


def write_atomically(path: Path, data: bytes) -> None:
    """The file is there whole or not at all, also after a power cut."""
    partial = path.with_name(path.name + ".partial")
    with partial.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    partial.replace(path)


def to_npz(recording: Recording) -> bytes:
    """The file's bytes: the arrays, and `fps`, `start_tick`, `skeleton`, `joints` and `objects`."""
    arrays: dict[str, Any] = {name: np.asarray(recording.arrays[name]) for name in FIELDS}
    arrays["fps"] = np.float64(TICK_HZ)
    arrays["start_tick"] = np.int64(recording.start_tick)
    arrays["skeleton"] = np.array(CANONICAL.id)
    arrays["joints"] = np.array(CANONICAL.names)
    arrays["objects"] = np.array(recording.objects, dtype="<U64")
    out = io.BytesIO()
    np.savez_compressed(out, **arrays)
    return out.getvalue()


def from_npz(path: Path) -> Recording:
    """Read a recording; never unpickles."""
    with np.load(path, allow_pickle=False) as data:
        arrays: dict[str, npt.NDArray[np.generic]] = {name: data[name] for name in FIELDS}
        return Recording(int(data["start_tick"]), arrays, tuple(str(name) for name in data["objects"]))


def joined(parts: list[Recording]) -> Recording:
    """Parts that follow one another as one recording."""
    arrays: dict[str, npt.NDArray[np.generic]] = {
        name: np.concatenate([part.arrays[name] for part in parts]) for name in FIELDS
    }
    return Recording(parts[0].start_tick, arrays, parts[0].objects)


class RecordingFiles:
    """Where the recordings of the store lie."""

    def __init__(self, folder: Path):
        self._folder = folder

    def path(self, episode_id: str, suffix: str = ".npz") -> Path:
        """The file of an episode, whether it is there or not."""
        return self._folder / f"{episode_id}{suffix}"

    def add_part(self, episode_id: str, part: TickRange) -> None:
        """Keep the next ticks of a running episode."""
        parts = self._folder / f"{episode_id}.parts"
        parts.mkdir(exist_ok=True)
        arrays: dict[str, npt.NDArray[np.generic]] = {name: np.asarray(getattr(part, name)) for name in FIELDS}
        recording = Recording(part.start_tick, arrays, tuple(part.objects))
        write_atomically(parts / f"{part.start_tick:010d}.npz", to_npz(recording))

    def finish(self, episode_id: str) -> Path | None:
        """Join the parts into the episode's one file (atomically) and drop them; None when nothing was recorded."""
        folder = self._folder / f"{episode_id}.parts"
        files = sorted(folder.glob("*.npz"))
        if not files:
            return None
        path = self.path(episode_id)
        write_atomically(path, to_npz(joined([from_npz(file) for file in files])))
        shutil.rmtree(folder)
        return path

    def unfinished(self) -> list[str]:
        """Episodes whose parts were never joined (the process was killed)."""
        return [folder.name.removesuffix(".parts") for folder in self._folder.glob("*.parts")]

    def load(self, episode_id: str) -> Recording:
        """An episode's recording; raises NotFoundError."""
        path = self.path(episode_id)
        if not path.exists():
            raise NotFoundError(f"episode {episode_id} has no recording (yet)", field="id")
        return from_npz(path)

    def delete(self, episode_id: str) -> None:
        """Remove every file of an episode."""
        for file in self._folder.glob(f"{episode_id}.*"):
            if file.is_dir():
                shutil.rmtree(file)
            else:
                file.unlink()
