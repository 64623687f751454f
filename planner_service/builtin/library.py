"""Recorded motion for the planner `clip`: files in a folder, at 20 fps, with the words that describe them.

Read are `*.npz` (positions_w_m (T, 22, 3) of the canonical skeleton, fps, texts), `*.bvh` (retargeted; the file's name
says what it shows) and a corpus folder of `motionloop data build`.
"""

from __future__ import annotations

import logging
import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from shared.data.corpus import Corpus
from shared.errors import InvalidInputError, MotionLoopError
from shared.motion.features import rotate_z
from shared.motion.heading import body_heading
from shared.motion.resampling import finite_velocity, resample
from shared.motion.skeleton import CANONICAL
from shared.protocol.messages import PLANNER_FPS

Array = npt.NDArray[np.float64]

SHORTEST_FRAMES = 24
KEY_JOINTS = ("pelvis", "left_knee", "left_ankle", "left_foot", "right_knee", "right_ankle", "right_foot", "head",
              "left_wrist", "right_wrist")  # fmt: skip
VELOCITY_WEIGHT_S = 0.12
"""A velocity difference of 1 m/s counts like 0.12 m."""
_FILLERS = frozenset(
    ("a", "an", "the", "is", "are", "person", "someone", "man", "woman", "then", "and", "while", "with", "of", "on",
     "in", "to", "their", "his", "her")
)  # fmt: skip
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class LibraryClip:
    """A piece of motion at 20 fps and its words.

    Attributes:
        positions_w_m: (T, 22, 3).
        features: (T, F) what `pose_features` says of each frame.
        activity_mps: (T,) mean speed of the hands and feet over the following second.
    """

    name: str
    sentences: tuple[frozenset[str], ...]
    positions_w_m: Array
    features: Array
    activity_mps: Array


@dataclass(frozen=True)
class ClipLibrary:
    """Clips to choose from; never empty."""

    clips: tuple[LibraryClip, ...]

    @classmethod
    def load(cls, folder: Path) -> ClipLibrary:
        """Read all that a folder holds. Raises InvalidInputError if that is nothing."""
        clips = [made for name, texts, p, fps in _entries(folder) if (made := make_clip(name, texts, p, fps))]
        if not clips:
            raise InvalidInputError(
                f"no recorded motion in {folder}", field="clip_library", allowed="*.npz, *.bvh or a built corpus"
            )
        return cls(tuple(clips))

    def matching(self, text: str) -> list[LibraryClip]:
        """Clips with a sentence most like the text; none if no sentence shares a word with it.

        Likeness is Dice's coefficient of the words, each weighted by how few sentences have it.
        """
        count = Counter(word for clip in self.clips for sentence in clip.sentences for word in sentence)
        total = sum(len(clip.sentences) for clip in self.clips)
        wanted = words_of(text)

        def weight(words: frozenset[str]) -> float:
            return sum(math.log(1 + total / max(1, count[word])) for word in words)

        def likeness(sentence: frozenset[str]) -> float:
            return 2 * weight(wanted & sentence) / max(1e-9, weight(wanted) + weight(sentence))

        scores = [max((likeness(sentence) for sentence in clip.sentences), default=0.0) for clip in self.clips]
        best = max(scores)
        return [clip for clip, score in zip(self.clips, scores, strict=True) if best > 0 and score >= 0.9 * best]


def words_of(text: str) -> frozenset[str]:
    """Lower-case words without fillers, cut down to their stems (walks, walking and walked are `walk`)."""
    return frozenset(_stem(word) for word in re.findall(r"[a-z]+", text.lower()) if word not in _FILLERS)


def _stem(word: str) -> str:
    for ending in ("ing", "es", "ed", "s", "e"):
        if word.endswith(ending) and len(word) - len(ending) >= 3:
            word = word.removesuffix(ending)
            break
    return word[:-1] if len(word) > 3 and word[-1] == word[-2] else word


def pose_features(positions_w_m: npt.ArrayLike, velocities_w_mps: npt.ArrayLike) -> Array:
    """(T, F) key joints' places and velocities as seen from the body, scaled to metres, of frames (T, 22, 3)."""
    p, v = np.asarray(positions_w_m, dtype=np.float64), np.asarray(velocities_w_mps, dtype=np.float64)
    keys = CANONICAL.indices(*KEY_JOINTS)
    turn = -body_heading(p)[:, None]
    places = rotate_z(p[:, keys] - p[:, :1] * np.array([1.0, 1.0, 0.0]), turn)
    speeds = rotate_z(v[:, keys], turn) * VELOCITY_WEIGHT_S
    return np.concatenate([places, speeds], axis=-1).reshape(len(p), -1) / math.sqrt(len(KEY_JOINTS))


def make_clip(name: str, texts: Iterable[str], positions_w_m: Array, fps: float) -> LibraryClip | None:
    """A clip at 20 fps; None if it is too short to plan from."""
    p = resample(positions_w_m, fps, PLANNER_FPS)
    if len(p) < SHORTEST_FRAMES:
        return None
    velocity = finite_velocity(p, PLANNER_FPS)
    ends = CANONICAL.indices("left_ankle", "right_ankle", "left_wrist", "right_wrist")
    speed = np.linalg.norm(velocity[:, ends], axis=-1).mean(axis=-1)
    total = np.concatenate([[0.0], np.cumsum(speed)])
    stop = np.minimum(np.arange(len(p)) + PLANNER_FPS, len(p))
    activity = (total[stop] - total[:-1]) / (stop - np.arange(len(p)))
    sentences = tuple(dict.fromkeys(words_of(text) for text in (*texts, name)))
    return LibraryClip(name, sentences, p, pose_features(p, velocity), activity)


def save_clip(folder: Path, name: str, texts: Iterable[str], positions_w_m: npt.ArrayLike, fps: float) -> Path:
    """Write one clip (T, 22, 3) as NAME.npz into a library folder."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.npz"
    positions = np.asarray(positions_w_m, dtype="<f4")
    np.savez_compressed(path, positions_w_m=positions, fps=np.float64(fps), texts=np.array(list(texts), dtype=np.str_))
    return path


def _entries(folder: Path) -> Iterator[tuple[str, tuple[str, ...], Array, float]]:
    """Name, texts, positions and rate of everything readable; what is not is named in the log and left out."""
    if (folder / "clips.json").is_file():
        corpus = Corpus.load(folder)
        for info, positions in corpus:
            if not info.mirrored:
                yield info.behaviour, info.texts, np.asarray(positions, dtype=np.float64), corpus.fps
        return
    for path in sorted(folder.glob("*.npz")):
        try:
            with np.load(path, allow_pickle=False) as data:
                texts = tuple(str(text) for text in np.atleast_1d(data["texts"]))
                yield path.stem, texts, np.asarray(data["positions_w_m"], dtype=np.float64), float(data["fps"])
        except (OSError, ValueError, KeyError) as error:
            log.warning("%s is left out: %s", path, error)
    for path in sorted(folder.glob("*.bvh")):
        try:
            yield path.stem.replace("_", " "), (), *_read_bvh(path)
        except MotionLoopError as error:
            log.warning("%s is left out: %s", path, error.message)


def _read_bvh(path: Path) -> tuple[Array, float]:
    """Canonical positions and their rate. Imports here: only a folder with BVH files needs the retargeting."""
    from shared.data.grounding import ground
    from shared.data.retarget import retarget
    from shared.motion.io.bvh import read_bvh
    from shared.protocol.rates import CORPUS_FPS as FPS

    positions, _ = ground(retarget(read_bvh(path)), FPS)
    return positions, FPS
