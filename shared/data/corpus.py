"""The corpus on disk: one array of positions at 30 fps, a list of clips, a manifest."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from shared.data.props import Seat, Strike, seat_from, strike_from
from shared.errors import InvalidInputError
from shared.motion.skeleton import CANONICAL
from shared.protocol.rates import CORPUS_FPS as FPS

FORMAT = 1


@dataclass(frozen=True)
class ClipInfo:
    """One clip of the corpus.

    Attributes:
        name: unique; take: the recording(s) it comes from, joined by '+'; source: the archive(s).
        behaviour: canonical id; action: finer label; texts: several sentences.
        split: 'train' or 'heldout'. made: not as recorded; mirrored: left and right exchanged.
        start, frames: its rows in the array of positions.
        weight: share of training samples it should get; sums to 1 over the training split.
        seat: what carries the body, in the clip's own frame; None where nothing but the floor does.
        strike: the point a limb hits and when, in the clip's own frame.
    """

    name: str
    take: str
    source: str
    behaviour: str
    action: str
    texts: tuple[str, ...]
    split: str
    made: bool
    mirrored: bool
    start: int
    frames: int
    weight: float
    seat: Seat | None = None
    strike: Strike | None = None


@dataclass(frozen=True)
class Corpus:
    """Clips of the canonical skeleton at 30 fps; see `Corpus.load`."""

    clips: tuple[ClipInfo, ...]
    array: npt.NDArray[np.float32]
    manifest: dict[str, Any]
    fps: float = FPS

    @classmethod
    def load(cls, folder: str | Path) -> Corpus:
        """Open a corpus; positions stay on disk and are mapped into memory.

        Raises:
            InvalidInputError: the folder holds no corpus of this format.
        """
        folder = Path(folder)
        try:
            manifest = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
            entries = json.loads((folder / "clips.json").read_text(encoding="utf-8"))
            array = np.load(folder / "positions.npy", mmap_mode="r", allow_pickle=False)
        except (OSError, ValueError) as error:
            raise InvalidInputError(f"{folder} holds no corpus: {error}", field="corpus") from error
        if manifest.get("format") != FORMAT or array.shape[1:] != (len(CANONICAL), 3):
            raise InvalidInputError(
                f"{folder}: corpus format {manifest.get('format')}, array {array.shape}",
                field="corpus",
                allowed=f"format {FORMAT}, (N, {len(CANONICAL)}, 3)",
            )
        clips = tuple(_info(entry) for entry in entries)
        return cls(clips, array, manifest)

    def __len__(self) -> int:
        return len(self.clips)

    def __iter__(self) -> Iterator[tuple[ClipInfo, npt.NDArray[np.float32]]]:
        return ((clip, self.positions(i)) for i, clip in enumerate(self.clips))

    def positions(self, i: int) -> npt.NDArray[np.float32]:
        """(frames, 22, 3) world positions of clip i in metres, Z up; its first frame is over the origin facing +X."""
        clip = self.clips[i]
        return self.array[clip.start : clip.start + clip.frames]

    def select(self, split: str | None = None, behaviour: str | None = None, made: bool | None = None) -> list[int]:
        """Indices of the clips that match."""
        return [
            i
            for i, c in enumerate(self.clips)
            if (split is None or c.split == split)
            and (behaviour is None or c.behaviour == behaviour)
            and (made is None or c.made == made)
        ]


def _info(entry: dict[str, Any]) -> ClipInfo:
    props = {"seat": seat_from(entry.get("seat")), "strike": strike_from(entry.get("strike"))}
    return ClipInfo(**{**entry, "texts": tuple(entry["texts"]), **props})


def write_corpus(
    folder: str | Path, clips: Sequence[tuple[ClipInfo, npt.NDArray[np.floating]]], manifest: dict[str, Any]
) -> None:
    """Write a corpus as a whole: a folder that exists is replaced only when all is written.

    The clips' `start` and `frames` are set here.
    """
    folder = Path(folder)
    scratch = folder.with_name(folder.name + ".part")
    shutil.rmtree(scratch, ignore_errors=True)
    scratch.mkdir(parents=True)
    starts = np.cumsum([0] + [len(p) for _, p in clips])
    array = np.concatenate([np.asarray(p, dtype=np.float32) for _, p in clips])
    np.save(scratch / "positions.npy", array)
    entries = [
        {**asdict(info), "start": int(start), "frames": len(p)}
        for (info, p), start in zip(clips, starts[:-1], strict=True)
    ]
    (scratch / "clips.json").write_text(json.dumps(entries, indent=0) + "\n", encoding="utf-8")
    (scratch / "manifest.json").write_text(json.dumps(manifest, indent=1) + "\n", encoding="utf-8")
    if folder.exists():
        shutil.rmtree(folder)
    scratch.rename(folder)
