"""Training windows out of a corpus: drawn by weight, joined, bent, disturbed, with texts and targets."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from planner_service.text.encoder import TextEncoder, pad_tokens
from planner_service.training.bending import bend, random_turns
from planner_service.training.disturbance import disturb
from planner_service.training.evidence import deed_ahead, plans_showing
from planner_service.training.joins import MAX_SPEED_GAP_MPS, JoinFinder, blend_frames, join, speed_gap_mps
from planner_service.training.windows import Features, repeat_first_rates, window_positions
from shared.data.corpus import Corpus
from shared.errors import InvalidInputError
from shared.motion.features import global_to_features
from shared.motion.resampling import resample
from shared.protocol.rates import PLANNER_FPS as FPS

Index = npt.NDArray[np.int64]

JOINED_SHARE = 1 / 3
OTHER_BEHAVIOUR_SHARE = 0.85
"""Of the joined windows, how many change the behaviour; the rest join two clips of the same one."""
DISTURBED_SHARE = 0.5
JOIN_SPREAD = 6
"""The joint lies within this many frames of the end of the prefix."""
JOIN_TRIES = 4
"""How many clips are tried to find one that a window can join."""


@dataclass(frozen=True)
class Material:
    """Features of all clips at 20 fps, one after another.

    Attributes:
        features: (N, 263); clip: (N,) clip of each frame.
        start, length: (C,) rows of each clip; weight: (C,) share of samples, sums to 1; behaviour: (C,) number.
        behaviours: names. actions: (C,) finer label of each clip. texts: sentences of each clip as rows of `sentences`.
    """

    features: Features
    clip: Index
    start: Index
    length: Index
    weight: npt.NDArray[np.float64]
    behaviour: Index
    behaviours: tuple[str, ...]
    actions: tuple[str, ...]
    texts: tuple[tuple[int, ...], ...]
    sentences: tuple[str, ...]


def load_material(corpus: Corpus, split: str, frames: int, cache: Path | None = None) -> Material:
    """The clips of a split that are at least `frames` long at 20 fps, as features.

    Args:
        corpus: where from.
        split: `train` or `heldout`.
        frames: shorter clips are left out.
        cache: folder to keep the features in (they take minutes); found again by the corpus' manifest.

    Raises:
        InvalidInputError: the split holds no such clip.
    """
    counts = {i: len(resample(np.zeros(corpus.clips[i].frames), corpus.fps, FPS)) for i in corpus.select(split=split)}
    chosen = [i for i, count in counts.items() if count >= frames]
    if not chosen:
        raise InvalidInputError(f"no clip of split {split!r} has {frames} frames at {FPS} fps", field="corpus")
    infos = [corpus.clips[i] for i in chosen]
    length = np.array([counts[i] for i in chosen])
    key = sha256(json.dumps([corpus.manifest, split, frames], sort_keys=True).encode()).hexdigest()[:16]
    kept = None if cache is None else cache / f"features_{key}.npy"
    if kept is not None and kept.is_file():
        features = np.load(kept, allow_pickle=False)
    else:
        features = np.concatenate(
            [global_to_features(resample(corpus.positions(i), corpus.fps, FPS), FPS).astype(np.float32) for i in chosen]
        )
        if kept is not None:
            kept.parent.mkdir(parents=True, exist_ok=True)
            np.save(kept, features)
    behaviours = tuple(sorted({c.behaviour for c in infos}))
    sentences = tuple(sorted({t for c in infos for t in c.texts}))
    row = {t: i for i, t in enumerate(sentences)}
    weight = np.array([c.weight for c in infos])
    weight = weight if weight.sum() > 0 else length.astype(np.float64)
    return Material(
        features=features,
        clip=np.repeat(np.arange(len(length)), length),
        start=np.concatenate([[0], np.cumsum(length)[:-1]]),
        length=length,
        weight=weight / weight.sum(),
        behaviour=np.array([behaviours.index(c.behaviour) for c in infos]),
        behaviours=behaviours,
        actions=tuple(c.action for c in infos),
        texts=tuple(tuple(row[t] for t in c.texts) for c in infos),
        sentences=sentences,
    )


def emphasized(material: Material, factors: Mapping[str, float]) -> Material:
    """Material whose clips of some behaviours or actions are drawn more (or less) often; both factors count.

    A name that is both is the behaviour, `action:NAME` is the action.

    Raises:
        InvalidInputError: a behaviour or action that the material does not have.
    """
    weight = material.weight.copy()
    actions = np.array(material.actions)
    for name, factor in factors.items():
        if name in material.behaviours:
            weight[material.behaviour == material.behaviours.index(name)] *= factor
        elif name.startswith("action:") and name.removeprefix("action:") in material.actions:
            weight[actions == name.removeprefix("action:")] *= factor
        else:
            known = [*material.behaviours, *(f"action:{a}" for a in sorted(set(material.actions)))]
            raise InvalidInputError(f"no behaviour or action {name!r}", field="emphasis", allowed=", ".join(known))
    return replace(material, weight=weight / weight.sum())


@dataclass(frozen=True)
class Told:
    """What B windows are told in words.

    Attributes:
        sentence, other: (B,) two sentences of the window's clip, maybe the same.
        share: (B,) float32, 0..1: how much of the other's pooled token is in the one shown; between two ways to say a
            thing lie others.
        pooled_alone: (B,) bool whether nothing but the pooled token is shown. keep: (B,) bool whether anything is.
    """

    sentence: Tensor
    other: Tensor
    share: Tensor
    pooled_alone: Tensor
    keep: Tensor


class TextBank:
    """All sentences of the corpus, encoded once."""

    def __init__(self, encoder: TextEncoder, sentences: Sequence[str]):
        tokens, mask = pad_tokens(encoder.encode(sentences), encoder.spec.dim)
        self._tokens, self._mask = torch.from_numpy(tokens), torch.from_numpy(mask)

    def pooled(self) -> Tensor:
        """(S, dim) the pooled token of every sentence."""
        return self._tokens[:, 0]

    def to(self, device: torch.device) -> TextBank:
        """The bank on a device; itself."""
        self._tokens, self._mask = self._tokens.to(device), self._mask.to(device)
        return self

    def told(self, told: Told) -> tuple[Tensor, Tensor]:
        """Token features (B, L, dim) and mask (B, L), see `Told`."""
        text, mask = self.rows(told.sentence, told.keep)
        text[:, 0] += told.share[:, None] * (self._tokens[told.other, 0] - text[:, 0])
        mask[:, 1:] &= ~told.pooled_alone[:, None]
        return text, mask

    def rows(self, index: Tensor, keep: Tensor) -> tuple[Tensor, Tensor]:
        """Token features (B, L, dim) and mask (B, L) of sentences; none where `keep` is False.

        L is that of the longest on a CPU; elsewhere it is always that of the bank, as asking would wait for the device.
        """
        mask = self._mask[index] & keep[:, None]
        if mask.device.type != "cpu":
            return self._tokens[index], mask
        length = max(int(mask.sum(-1).max()), 1)
        return self._tokens[index, :length], mask[:, :length]


@dataclass(frozen=True)
class WindowBatch:
    """B windows.

    Attributes:
        features: (B, T, 263) float32.
        clip: (B,) clip that the plan comes from; sentence, other: (B,) two of its sentences.
        shown: (B,) whether the plan shows what the sentence says.
        bent: (B,) whether the path was bent, which no sentence says.
    """

    features: Tensor
    clip: Index
    sentence: Index
    other: Index
    shown: npt.NDArray[np.bool_]
    bent: npt.NDArray[np.bool_]


class WindowSampler:
    """Draws batches of windows; all its randomness is one generator that can be saved and restored.

    Args:
        material: clips.
        prefix_frames, plan_frames: of a window.
        seed: of the generator.
        augment: join, bend and disturb; False gives windows as recorded.
    """

    def __init__(self, material: Material, prefix_frames: int, plan_frames: int, seed: int, augment: bool = True):
        self.material = material
        self._prefix = prefix_frames
        self._frames = prefix_frames + plan_frames
        self._augment = augment
        self._rng = np.random.default_rng(seed)
        place = np.arange(len(material.features)) - material.start[material.clip]
        left = material.length[material.clip] - place
        behaviour = material.behaviour[material.clip]
        # A joint may enter anywhere that leaves enough frames for the rest of a window after the earliest joint.
        enterable = (place >= 1) & (left >= plan_frames + JOIN_SPREAD)
        for number, (start, length) in enumerate(zip(material.start, material.length, strict=True)):
            rows = slice(start, start + length)
            name = material.behaviours[material.behaviour[number]]
            enterable[rows] &= deed_ahead(material.features[rows], name, plan_frames - JOIN_SPREAD)
        self._finder = JoinFinder(material.features, behaviour, enterable) if augment else None
        self._share = np.bincount(material.behaviour, material.weight, len(material.behaviours))

    @property
    def rng(self) -> np.random.Generator:
        """The generator, which the trainer draws from too."""
        return self._rng

    def state(self) -> str:
        """State of the generator as JSON."""
        return json.dumps(self._rng.bit_generator.state)

    def restart(self, seed: Sequence[int]) -> None:
        """Begin anew with a generator of this seed."""
        self._rng = np.random.default_rng(seed)

    def restore(self, state: str) -> None:
        """Continue from a state that `state` gave."""
        self._rng.bit_generator.state = json.loads(state)

    def draw(self, batch: int) -> WindowBatch:
        """The next `batch` windows."""
        m, rng = self.material, self._rng
        clip = rng.choice(len(m.weight), size=batch, p=m.weight)
        begin = m.start[clip] + (rng.random(batch) * (m.length[clip] - self._frames + 1)).astype(np.int64)
        windows = m.features[begin[:, None] + np.arange(self._frames)]
        bent = np.zeros(batch, np.bool_)
        if self._finder is not None:
            joined = rng.random(batch) < JOINED_SHARE
            rows = np.flatnonzero(joined)
            if len(rows):
                made, joined_windows, joined_clip = self._join(clip[rows])
                windows[rows[made]], clip[rows[made]] = joined_windows, joined_clip
            turns = random_turns(windows, self._prefix, rng)
            windows = bend(windows, turns)
            bent = (turns != 0.0).any(axis=1)
            rows = np.flatnonzero(rng.random(batch) < DISTURBED_SHARE)
            if len(rows):
                windows[rows] = disturb(windows[rows], self._prefix, rng)
        windows = repeat_first_rates(windows, window_positions(windows[:, :1])[:, 0])
        sentence, other = np.array([[m.texts[c][rng.integers(len(m.texts[c]))] for c in clip] for _ in range(2)])
        shown = plans_showing(windows[:, self._prefix :], [m.behaviours[m.behaviour[c]] for c in clip])
        return WindowBatch(torch.from_numpy(windows), clip, sentence, other, shown, bent)

    def _join(self, clip: Index) -> tuple[npt.NDArray[np.bool_], Features, Index]:
        """Windows that leave each of `clip` for another: which of them a body could perform, those, and the clips that
        they end in."""
        m, rng, finder = self.material, self._rng, self._finder
        assert finder is not None
        before = rng.integers(self._prefix - JOIN_SPREAD, self._prefix + JOIN_SPREAD + 1, len(clip))
        last = m.start[clip] + before + (rng.random(len(clip)) * (m.length[clip] - before)).astype(np.int64) - 1
        last = np.maximum(last, m.start[clip] + before - 1)
        enter, distance = np.zeros(len(last), np.int64), np.zeros(len(last))
        made = np.zeros(len(last), np.bool_)
        can = finder.behaviours
        for row, frame in enumerate(last):
            own = int(m.behaviour[clip[row]])
            share = self._share[can].copy()
            if rng.random() < OTHER_BEHAVIOUR_SHARE and len(can) > 1:
                share[[b == own for b in can]] = 0.0
            if share.sum() == 0:
                share[:] = 1.0
            for _ in range(JOIN_TRIES):
                wanted = can[int(rng.choice(len(can), p=share / share.sum()))]
                enter[row], distance[row] = finder.find(int(frame), wanted, rng)
                if speed_gap_mps(m.features, int(frame), int(enter[row])) <= MAX_SPEED_GAP_MPS:
                    made[row] = True
                    break
        if not made.any():
            return made, m.features[np.zeros((0, self._frames), np.int64)], clip[:0]
        last, enter, before, distance = last[made], enter[made], before[made], distance[made]
        windows = join(m.features, last, enter, before, blend_frames(distance), self._frames)
        return made, windows, m.clip[enter]


def feature_statistics(sampler: WindowSampler, batches: int = 16) -> tuple[Tensor, Tensor]:
    """Mean and standard deviation (263,) over drawn windows; the deviation has a floor, so that nothing explodes."""
    frames = torch.cat([sampler.draw(128).features.flatten(0, 1) for _ in range(batches)])
    return frames.mean(0), frames.std(0).clamp_min(0.05)
