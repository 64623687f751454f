"""Pairs of motion and sentence: drawn for training, and the fixed held-out ones that everything is judged on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from planner_service.training.dataset import Material
from planner_service.training.evaluator.meanings import Meanings
from planner_service.training.evaluator.network import FRAMES_A_TOKEN
from planner_service.training.evidence import LEAST_FRAMES, frames_showing
from planner_service.training.windows import Features

Index = npt.NDArray[np.int64]

LEAST, MOST = 40, 100
"""Frames of a motion that is judged: 2 to 5 s."""
TRIES = 8


@dataclass(frozen=True)
class Pairs:
    """N motions with a sentence each.

    Attributes:
        clip: (N,) of the material; begin: (N,) its first row among the material's features; frames: (N,) its length.
        sentence: (N,) row of the material's sentences; meaning: (N,).
    """

    clip: Index
    begin: Index
    frames: Index
    sentence: Index
    meaning: Index

    def motions(self, material: Material) -> list[Features]:
        """Features (T_i, 263) of every motion."""
        return [material.features[b : b + n] for b, n in zip(self.begin, self.frames, strict=True)]

    def some(self, rows: Index) -> Pairs:
        """Those of the given rows."""
        return Pairs(self.clip[rows], self.begin[rows], self.frames[rows], self.sentence[rows], self.meaning[rows])


class Deeds:
    """Which stretches of a material's clips show what their sentences are about."""

    def __init__(self, material: Material):
        shown = np.zeros(len(material.features) + 1, np.int64)
        for number, (start, length) in enumerate(zip(material.start, material.length, strict=True)):
            name = material.behaviours[material.behaviour[number]]
            rows = slice(start, start + length)
            shown[start + 1 : start + length + 1] = frames_showing(material.features[rows], name)
        self._before = np.cumsum(shown)
        least = [LEAST_FRAMES.get(name, 0) for name in material.behaviours]
        self._least = np.array(least)[material.behaviour]

    def seen(self, clip: Index, begin: Index, frames: Index) -> npt.NDArray[np.bool_]:
        """(N,) for stretches of `frames` rows from `begin` on, of clips `clip`."""
        return np.asarray(self._before[begin + frames] - self._before[begin] >= self._least[clip])


class PairSampler:
    """Draws batches for training: half by the corpus' weights, half every meaning as often."""

    def __init__(self, material: Material, meanings: Meanings, seed: int):
        self._material, self._meanings = material, meanings
        self._deeds = Deeds(material)
        self._rng = np.random.default_rng(seed)
        count = np.bincount(meanings.of_clip, minlength=len(meanings.names))
        self._share = 0.5 * material.weight + 0.5 / (len(meanings.names) * count[meanings.of_clip])
        widest = max(len(texts) for texts in material.texts)
        self._texts = np.array([np.resize(texts, widest) for texts in material.texts])
        self._text_count = np.array([len(texts) for texts in material.texts])

    def draw(self, batch: int) -> Pairs:
        """The next `batch` pairs: a stretch of each clip that shows its deed, where one is found."""
        rng = self._rng
        clip = rng.choice(len(self._share), size=batch, p=self._share)
        begin, frames = self._stretch(clip)
        for _ in range(TRIES):
            missing = np.flatnonzero(~self._deeds.seen(clip, begin, frames))
            if not len(missing):
                break
            begin[missing], frames[missing] = self._stretch(clip[missing])
        sentence = self._texts[clip, (rng.random(batch) * self._text_count[clip]).astype(np.int64)]
        return Pairs(clip, begin, frames, sentence, self._meanings.of_clip[clip])

    def features(self, pairs: Pairs) -> tuple[Tensor, Tensor]:
        """Features (B, T, 263), the rest of each motion's clip or others' frames behind its end, and lengths (B,)."""
        frames = int(pairs.frames.max())
        rows = np.minimum(pairs.begin[:, None] + np.arange(frames), len(self._material.features) - 1)
        return torch.from_numpy(self._material.features[rows]), torch.from_numpy(pairs.frames)

    def _stretch(self, clip: Index) -> tuple[Index, Index]:
        m, rng = self._material, self._rng
        most = np.minimum(m.length[clip], MOST)
        frames = (LEAST + rng.random(len(clip)) * (most - LEAST + 1)).astype(np.int64)
        frames -= frames % FRAMES_A_TOKEN
        begin = m.start[clip] + (rng.random(len(clip)) * (m.length[clip] - frames + 1)).astype(np.int64)
        return begin, frames


def fixed_pairs(material: Material, meanings: Meanings, prefix: int, seed: int) -> Pairs:
    """One pair a clip: what follows its first `prefix` frames, with one of the sentences that say most of it.

    Clips whose continuation does not show their deed any more are left out.
    """
    rng = np.random.default_rng(seed)
    clip = np.arange(len(material.length))
    begin = material.start + prefix
    frames = np.minimum(material.length - prefix, MOST)
    frames -= frames % FRAMES_A_TOKEN
    sentence = np.array([rng.choice(meanings.specific(texts)) for texts in material.texts])
    keep = (frames >= LEAST) & Deeds(material).seen(clip, begin, np.maximum(frames, 0))
    return Pairs(clip[keep], begin[keep], frames[keep], sentence[keep], meanings.of_clip[keep])
