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
from shared.motion.characters import build
from shared.motion.skeleton import CANONICAL, Skeleton
from shared.protocol.messages import TICK_HZ, TickRange
from shared.scenes.schema import Scene

FIELDS = (
    "body_pos_w_m",
    "body_quat_w",
    "body_linvel_w_mps",
    "contacts",
    "object_pose_w",
    "tracking_error_m",
    "fallen",
    "reference_pos_w_m",
    "body_angvel_w_radps",
    "hinge_pos_rad",
    "hinge_vel_radps",
    "servo_target_rad",
    "object_vel_w",
)
CONTACTS = ("contact_body", "contact_object", "contact_impulse_ns")
"""A row a contact, with the row of the tick it belongs to in `contact_sample` (shared.protocol.states)."""
RESUME = "resume.state"
LARGE_TICKS = 600
"""Parts are gathered until they are so long."""


@dataclass(frozen=True)
class Recording:
    """Control ticks start_tick.. at 30 Hz; arrays as in `TickRange`.

    Attributes:
        objects: names of the scene's objects. character: whose motion it is (shared.motion.characters).
        scene: what the objects look like; None where nobody knows.
    """

    start_tick: int
    arrays: dict[str, npt.NDArray[np.generic]]
    objects: tuple[str, ...] = ()
    character: str = "human"
    scene: Scene | None = None

    def __len__(self) -> int:
        return len(self.arrays["body_pos_w_m"])

    @property
    def nbytes(self) -> int:
        """What the arrays take."""
        return sum(array.nbytes for array in self.arrays.values())

    @property
    def skeleton(self) -> Skeleton:
        """The character's skeleton."""
        return build(self.character).skeleton

    @classmethod
    def of(cls, part: TickRange, character: str = "human", scene: Scene | None = None) -> Recording:
        """From a range of the log."""
        arrays: dict[str, npt.NDArray[np.generic]] = {
            name: np.asarray(getattr(part, name)) for name in (*FIELDS, "contact_sample", *CONTACTS)
        }
        return cls(part.start_tick, arrays, tuple(part.objects), character, scene)


def write_atomically(path: Path, data: bytes) -> None:
    """The file is there whole or not at all, also after a power cut."""
    partial = path.with_name(path.name + ".partial")
    with partial.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    partial.replace(path)


def to_npz(recording: Recording) -> bytes:
    """The file's bytes: the arrays, and `fps`, `start_tick`, `character`, `skeleton`, `joints`, `objects`, `scene`."""
    names = (*FIELDS, "contact_sample", *CONTACTS)
    arrays: dict[str, Any] = {name: np.asarray(recording.arrays[name]) for name in names}
    arrays["fps"] = np.float64(TICK_HZ)
    arrays["start_tick"] = np.int64(recording.start_tick)
    arrays["character"] = np.array(recording.character)
    arrays["skeleton"] = np.array(recording.skeleton.id)
    arrays["joints"] = np.array(recording.skeleton.names)
    arrays["scene"] = np.array("" if recording.scene is None else recording.scene.model_dump_json())
    arrays["objects"] = np.array(recording.objects, dtype="<U64")
    out = io.BytesIO()
    np.savez_compressed(out, **arrays)
    return out.getvalue()


def from_npz(path: Path) -> Recording:
    """Read a recording; never unpickles. One of version 1 has no rates, hinges and contacts: those are empty then."""
    with np.load(path, allow_pickle=False) as data:
        count, objects = len(data["body_pos_w_m"]), tuple(str(name) for name in data["objects"])
        arrays = {name: data[name] for name in (*FIELDS, "contact_sample", *CONTACTS) if name in data}
        bodies, wide = len(CANONICAL), len(objects)
        for name, shape in (
            ("body_angvel_w_radps", (bodies, 3)), ("object_vel_w", (wide, 6)),
            ("hinge_pos_rad", (0,)), ("hinge_vel_radps", (0,)), ("servo_target_rad", (0,)),
        ):  # fmt: skip
            arrays.setdefault(name, np.zeros((count, *shape), "<f4"))
        for name in ("contact_sample", "contact_body", "contact_object"):
            arrays.setdefault(name, np.zeros(0, "<i8"))
        arrays.setdefault("contact_impulse_ns", np.zeros(0, "<f4"))
        character = str(data["character"]) if "character" in data else "human"
        text = str(data["scene"]) if "scene" in data else ""
        scene = Scene.model_validate_json(text) if text else None
        return Recording(int(data["start_tick"]), arrays, objects, character, scene)


def joined(parts: list[Recording]) -> Recording:
    """Parts that follow one another as one recording."""
    arrays: dict[str, npt.NDArray[np.generic]] = {
        name: np.concatenate([part.arrays[name] for part in parts]) for name in (*FIELDS, *CONTACTS)
    }
    starts = np.cumsum([0, *(len(part) for part in parts)])
    arrays["contact_sample"] = np.concatenate(
        [part.arrays["contact_sample"] + start for part, start in zip(parts, starts[:-1], strict=True)]
    )
    first = parts[0]
    return Recording(first.start_tick, arrays, first.objects, first.character, first.scene)


class RecordingFiles:
    """Where the recordings of the store lie."""

    def __init__(self, folder: Path):
        self._folder = folder

    def path(self, episode_id: str, suffix: str = ".npz") -> Path:
        """The file of an episode, whether it is there or not."""
        return self._folder / f"{episode_id}{suffix}"

    def add_part(self, episode_id: str, recording: Recording) -> None:
        """Keep the next ticks of a running episode."""
        parts = self._parts(episode_id)
        parts.mkdir(exist_ok=True)
        write_atomically(parts / _part_name(recording.start_tick, len(recording)), to_npz(recording))

    def add_resume(self, episode_id: str, data: bytes, tick: int) -> None:
        """Keep what a running episode is taken up from after a restart, at a tick with which a part ends; then gather
        small parts up to there into larger ones."""
        self._parts(episode_id).mkdir(exist_ok=True)
        write_atomically(self._parts(episode_id) / RESUME, data)
        spans = [span for span in self._spans(episode_id) if span[0] <= tick]
        large = max((i + 1 for i, (_, count) in enumerate(spans) if count >= LARGE_TICKS), default=0)
        if sum(count for _, count in spans[large:]) >= LARGE_TICKS:
            self._gather(episode_id, spans[large:])

    def resume(self, episode_id: str) -> bytes | None:
        """What `add_resume` has kept; None where nothing is."""
        path = self._parts(episode_id) / RESUME
        return path.read_bytes() if path.exists() else None

    def recorded(self, episode_id: str, last_tick: int) -> Recording:
        """The parts of an unfinished episode up to a tick at which one of them ends; those after it are dropped, and so
        is the one file of who was killed before the end was noted: it goes on.

        Raises NotFoundError where ticks are missing.
        """
        self.path(episode_id).unlink(missing_ok=True)
        self.drop_after(episode_id, last_tick)
        parts = self._read_parts(episode_id)
        found = joined(parts) if parts else None
        if found is None or found.start_tick != 0 or len(found) != last_tick + 1:
            raise NotFoundError(f"not all of the ticks 0..{last_tick} of episode {episode_id} are there", field="id")
        return found

    def finish(self, episode_id: str, drop: bool = True) -> Path | None:
        """Join the parts into the episode's one file (atomically) and drop them, unless told to leave them; None when
        nothing was recorded."""
        parts = self._read_parts(episode_id)
        if not parts:
            return None
        path = self.path(episode_id)
        write_atomically(path, to_npz(joined(parts)))
        if drop:
            self.drop_parts(episode_id)
        return path

    def drop_after(self, episode_id: str, tick: int) -> None:
        """Remove the parts that begin after a tick."""
        for start, count in self._spans(episode_id):
            if start > tick:
                (self._parts(episode_id) / _part_name(start, count)).unlink()

    def drop_parts(self, episode_id: str) -> None:
        """Remove what an unfinished episode is made whole from."""
        shutil.rmtree(self._parts(episode_id), ignore_errors=True)

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

    def _parts(self, episode_id: str) -> Path:
        return self._folder / f"{episode_id}.parts"

    def _spans(self, episode_id: str) -> list[tuple[int, int]]:
        """First tick and number of ticks of the parts, in order. Not of those that are in a larger one, which a kill
        leaves while parts are gathered."""
        names = (file.stem.partition("-") for file in self._parts(episode_id).glob("*.npz"))
        out: list[tuple[int, int]] = []
        for start, count in sorted(((int(a), int(b)) for a, _, b in names), key=lambda span: (span[0], -span[1])):
            if not out or start >= sum(out[-1]):
                out.append((start, count))
        return out

    def _read_parts(self, episode_id: str) -> list[Recording]:
        return [from_npz(self._parts(episode_id) / _part_name(*span)) for span in self._spans(episode_id)]

    def _gather(self, episode_id: str, spans: list[tuple[int, int]]) -> None:
        files = [self._parts(episode_id) / _part_name(*span) for span in spans]
        whole = joined([from_npz(file) for file in files])
        write_atomically(self._parts(episode_id) / _part_name(whole.start_tick, len(whole)), to_npz(whole))
        for file in files:
            file.unlink()


def _part_name(start_tick: int, ticks: int) -> str:
    return f"{start_tick:010d}-{ticks}.npz"
