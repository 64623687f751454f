"""What a text encoder is, and a cache in front of one.

DiP attends to the features of every token of the sentence (REFERENCE 1). A pooled token (the mean over the tokens, the
vector MiniLM was trained on, so that paraphrases lie close together) goes first.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from threading import Lock
from typing import Protocol

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float32]


@dataclass(frozen=True)
class TextEncoderSpec:
    """Which encoder made an embedding.

    Attributes:
        name: e.g. `minilm-l6-v2`; weights of DiP say which encoder they need.
        dim: numbers in a token's feature.
        sha256: of the encoder's weights.
        max_tokens: tokens kept of a sentence, the pooled one included.
    """

    name: str
    dim: int
    sha256: str
    max_tokens: int


class TextEncoder(Protocol):
    """Turns sentences into token features."""

    @property
    def spec(self) -> TextEncoderSpec:
        """Which encoder this is."""
        ...

    def encode(self, texts: Sequence[str]) -> list[FloatArray]:
        """One (tokens, dim) array a text; token 0 is the mean over the others."""
        ...


class CachedTextEncoder:
    """Keeps the features of the last `capacity` texts, least recently used out first. Safe to share by threads."""

    def __init__(self, encoder: TextEncoder, capacity: int = 1024):
        self._encoder = encoder
        self._capacity = capacity
        self._kept: OrderedDict[str, FloatArray] = OrderedDict()
        self._lock = Lock()
        self.hits = 0
        self.misses = 0

    @property
    def spec(self) -> TextEncoderSpec:
        """Of the encoder behind the cache."""
        return self._encoder.spec

    def encode(self, texts: Sequence[str]) -> list[FloatArray]:
        """As `TextEncoder.encode`; only texts not seen lately are computed."""
        with self._lock:
            missing = list(dict.fromkeys(t for t in texts if t not in self._kept))
            self.misses += len(missing)
            self.hits += len(texts) - len(missing)
            fresh = dict(zip(missing, self._encoder.encode(missing), strict=True)) if missing else {}
            result = []
            for text in texts:
                features = fresh[text] if text in fresh else self._kept[text]
                self._kept[text] = features
                self._kept.move_to_end(text)
                result.append(features)
            while len(self._kept) > self._capacity:
                self._kept.popitem(last=False)
            return result


def pad_tokens(features: Sequence[FloatArray], dim: int) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """Token features of several texts as one array.

    Args:
        features: (tokens_i, dim) each; an empty array stands for "no text".
        dim: numbers in a token's feature.

    Returns:
        (B, L, dim) zero-padded features and (B, L) mask, True where a token is; L >= 1.
    """
    length = max([1, *(len(f) for f in features)])
    out = np.zeros((len(features), length, dim), np.float32)
    mask = np.zeros((len(features), length), np.bool_)
    for row, f in enumerate(features):
        out[row, : len(f)] = f
        mask[row, : len(f)] = True
    return out, mask
