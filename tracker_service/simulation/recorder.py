"""The log of one character: every 120 Hz sample of its life, in bounded memory, older parts on disk.

Sample k is the state at exactly k / 120 s, after a physics step. A tick is every fourth sample, a frame at 20 fps every
sixth: reading at any rate that divides 120 picks recorded samples and never interpolates (DESIGN 2).
"""

from __future__ import annotations

import contextlib
import threading
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from shared.errors import InvalidInputError, MotionLoopError
from shared.protocol.rates import LOG_HZ, LOG_RATES

AnyArray = npt.NDArray[np.generic]
Samples = dict[str, AnyArray]


@dataclass
class _Chunk:
    """Consecutive samples first..first+count-1; `arrays` is None once they are on disk."""

    first: int
    count: int
    arrays: Samples | None
    path: Path | None = None


class RecordingLostError(MotionLoopError):
    """A part of the log was spilled to disk and cannot be read back."""

    code = "recording_lost"


def sample_stride(rate_hz: int) -> int:
    """Samples from one reading to the next at `rate_hz`; raises InvalidInputError for a rate that would interpolate."""
    if rate_hz not in LOG_RATES:
        raise InvalidInputError(f"rate_hz is {rate_hz}", field="rate_hz", allowed=", ".join(map(str, LOG_RATES)))
    return LOG_HZ // rate_hz


@dataclass
class Recorder:
    """Append-only log of named arrays with one row a sample.

    Memory holds at most `memory_chunks` full chunks and the one being filled; the oldest full chunk moves to an .npz
    file in `spool_dir`. When the disk refuses (full, read-only) the chunk stays in memory and the next append tries
    again: the loop goes on and nothing is lost. One thread appends; any may read meanwhile, and reading from disk does
    not hold the appending one up.

    Args:
        spool_dir: folder for the spilled chunks, made on the first spill.
        chunk_samples: samples a chunk.
        memory_chunks: full chunks kept in memory.
        first_sample: index of the first sample to come (a restored character begins later than 0).
    """

    spool_dir: Path
    chunk_samples: int = 1200
    memory_chunks: int = 6
    first_sample: int = 0
    spill_failures: int = 0
    _chunks: list[_Chunk] = field(default_factory=list)
    _open: Samples = field(default_factory=dict)
    _open_count: int = 0
    _cached: tuple[Path, Samples] | None = None
    _lock: threading.Lock = field(default_factory=threading.Lock)

    @property
    def next_sample(self) -> int:
        """Index of the sample that the next append will write first."""
        sealed = self._chunks[-1].first + self._chunks[-1].count if self._chunks else self.first_sample
        return sealed + self._open_count

    @property
    def memory_bytes(self) -> int:
        """Bytes of samples now in memory."""
        held = [c.arrays for c in self._chunks if c.arrays is not None] + [self._open]
        return sum(a.nbytes for arrays in held for a in arrays.values())

    @property
    def spilled_chunks(self) -> int:
        """How many chunks are on disk."""
        return sum(c.path is not None for c in self._chunks)

    def append(self, samples: Mapping[str, AnyArray]) -> None:
        """Add N samples: arrays (N, ...) of the same N."""
        counts = {a.shape[0] for a in samples.values()}
        if len(counts) != 1:
            raise InvalidInputError("arrays of unequal length", field="samples", allowed="one length for all")
        count = counts.pop()
        if count == 0:
            return
        with self._lock:
            if self._open_count and not _same_layout(self._open, samples):
                self._seal()
            stop = self._open_count + count
            if not self._open_count or stop > len(next(iter(self._open.values()))):
                self._make_room(max(stop, self.chunk_samples), samples)
            for name, rows in samples.items():
                self._open[name][self._open_count : stop] = rows
            self._open_count = stop
            if self._open_count >= self.chunk_samples:
                self._seal()

    def read(self, start: int, stop: int, stride: int = 1, only: str | None = None) -> Samples:
        """Samples start, start + stride, ... < stop in order, as arrays (N, ...); all of them, or `only` one.

        Indices before the first sample read as the first one (a character stood still before it existed). Rows
        written under another layout (objects of an earlier scene) are cut or zero-padded to the newest layout read.

        Raises:
            InvalidInputError: nothing recorded yet, or `stop` beyond the last sample.
            RecordingLostError: a spilled chunk is gone from the disk.
        """
        with self._lock:
            end = self.next_sample
            if end == self.first_sample:
                raise InvalidInputError("nothing is recorded yet", field="stop_tick")
            if stop > end:
                raise InvalidInputError(
                    f"samples up to {stop - 1} asked for, {end - 1} is the last", field="stop_tick", allowed="<= now"
                )
            wanted = np.maximum(np.arange(start, stop, stride), self.first_sample)
            first, last = (int(wanted[0]), int(wanted[-1])) if wanted.size else (end - 1, end - 1)
            chunks = self._overlapping(first, last)
        parts: list[Samples] = []
        for chunk in chunks:
            rows = wanted[(wanted >= chunk.first) & (wanted < chunk.first + chunk.count)] - chunk.first
            arrays = self._load(chunk)
            parts.append({name: arrays[name][rows] for name in (arrays if only is None else (only,))})
        template = parts[-1]
        return {name: np.concatenate([_fit(part[name], template[name]) for part in parts]) for name in template}

    def read_sums(self, name: str, start: int, stop: int, stride: int) -> AnyArray:
        """One array as `read` gives its rows, but each the sum over the `stride` samples up to and with its own.

        Raises:
            InvalidInputError, RecordingLostError: as `read`.
        """
        rows = range(start, stop, stride)
        if len(rows) == 0 or stride == 1:
            return self.read(start, stop, stride, name)[name]
        first = rows[0] - stride + 1
        every = self.read(first, rows[-1] + 1, only=name)[name]
        # Times before the first sample read as that sample, which must count once.
        every = np.where(_column(np.arange(first, rows[-1] + 1) >= self.first_sample, every), every, 0)
        return np.asarray(every.reshape(len(rows), stride, *every.shape[1:]).sum(axis=1))

    def truncate(self, next_sample: int) -> None:
        """Forget the samples from `next_sample` on (a restore to an earlier tick continues from there)."""
        with self._lock:
            if next_sample >= self.next_sample:
                return
            self._seal()
            while self._chunks and self._chunks[-1].first + self._chunks[-1].count > next_sample:
                chunk = self._chunks.pop()
                keep = next_sample - chunk.first
                if keep > 0:
                    arrays = self._load(chunk)
                    self._chunks.append(_Chunk(chunk.first, keep, {n: a[:keep] for n, a in arrays.items()}))
                _discard(chunk)
            self._cached = None
            if not self._chunks:
                self.first_sample = next_sample

    def begin_at(self, first_sample: int) -> None:
        """Forget everything; the next sample to come is `first_sample`."""
        self.truncate(self.first_sample)
        self.first_sample = first_sample

    def close(self) -> None:
        """Delete the spilled files and forget everything."""
        with self._lock:
            for chunk in self._chunks:
                _discard(chunk)
            self._chunks.clear()
            self._open.clear()
            self._open_count = 0
            self._cached = None
        with contextlib.suppress(OSError):
            self.spool_dir.rmdir()

    def _make_room(self, count: int, like: Mapping[str, AnyArray]) -> None:
        """Arrays for so many open samples, in which the present ones are kept. Rows once written never change: what was
        read stays valid while more are added."""
        new = {name: np.empty((count, *rows.shape[1:]), rows.dtype) for name, rows in like.items()}
        if self._open_count:
            for name, rows in new.items():
                rows[: self._open_count] = self._open[name][: self._open_count]
        self._open = new

    def _tail(self) -> _Chunk:
        first = self.next_sample - self._open_count
        return _Chunk(first, self._open_count, {name: rows[: self._open_count] for name, rows in self._open.items()})

    def _overlapping(self, first: int, last: int) -> list[_Chunk]:
        """Copies of the chunks that hold samples first..last, which stay valid after the lock is released."""
        out = [
            _Chunk(chunk.first, chunk.count, chunk.arrays, chunk.path)
            for chunk in self._chunks
            if chunk.first <= last and chunk.first + chunk.count > first
        ]
        if self._open_count and (tail := self._tail()).first <= last:
            out.append(tail)
        return out

    def _seal(self) -> None:
        if not self._open_count:
            return
        tail = self._tail()
        assert tail.arrays is not None
        self._chunks.append(replace(tail, arrays={name: rows.copy() for name, rows in tail.arrays.items()}))
        self._open, self._open_count = {}, 0
        in_memory = [c for c in self._chunks if c.arrays is not None]
        for chunk in in_memory[: max(0, len(in_memory) - self.memory_chunks)]:
            self._spill(chunk)

    def _spill(self, chunk: _Chunk) -> None:
        assert chunk.arrays is not None
        path = self.spool_dir / f"samples_{chunk.first:09d}.npz"
        try:
            self.spool_dir.mkdir(parents=True, exist_ok=True)
            with path.with_suffix(".tmp").open("wb") as out:
                np.savez(out, **chunk.arrays)  # type: ignore[arg-type]
            path.with_suffix(".tmp").replace(path)
        except OSError:
            self.spill_failures += 1
            return
        chunk.path, chunk.arrays = path, None

    def _load(self, chunk: _Chunk) -> Samples:
        if chunk.arrays is not None:
            return chunk.arrays
        assert chunk.path is not None
        cached = self._cached
        if cached is not None and cached[0] == chunk.path:
            return cached[1]
        try:
            with np.load(chunk.path, allow_pickle=False) as data:
                arrays: Samples = {name: data[name] for name in data.files}
        except (OSError, ValueError, zipfile.BadZipFile) as error:
            raise RecordingLostError(f"recorded samples in {chunk.path} cannot be read: {error}") from error
        self._cached = (chunk.path, arrays)
        return arrays


def _same_layout(a: Mapping[str, AnyArray], b: Mapping[str, AnyArray]) -> bool:
    return a.keys() == b.keys() and all(a[n].shape[1:] == b[n].shape[1:] and a[n].dtype == b[n].dtype for n in a)


def _fit(rows: AnyArray, template: AnyArray) -> AnyArray:
    """`rows` (N, ...) cut or zero-padded so that its trailing shape is the template's."""
    if rows.shape[1:] == template.shape[1:]:
        return rows
    out = np.zeros((rows.shape[0], *template.shape[1:]), template.dtype)
    overlap = tuple(slice(0, min(a, b)) for a, b in zip(rows.shape[1:], template.shape[1:], strict=True))
    out[(slice(None), *overlap)] = rows[(slice(None), *overlap)]
    return out


def _column(mask: npt.NDArray[np.bool_], like: AnyArray) -> npt.NDArray[np.bool_]:
    """A mask (N,) shaped to go with rows (N, ...)."""
    return mask.reshape(-1, *[1] * (like.ndim - 1))


def _discard(chunk: _Chunk) -> None:
    if chunk.path is not None:
        with contextlib.suppress(OSError):
            chunk.path.unlink()
