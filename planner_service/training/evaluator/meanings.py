"""What sentences and clips mean: an action and a side. Motions are told apart by meaning, not by wording."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from planner_service.training.dataset import Material

Index = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]

_SIDES = {side: re.compile(rf"\b{side}\b") for side in ("left", "right")}


@dataclass(frozen=True)
class Meanings:
    """Meanings of a material's clips and sentences.

    Attributes:
        names: M of them, as `turn:left` or `jump`.
        of_clip: (C,) which one a clip has.
        said: (S, M) whether a clip of the meaning carries the sentence: "turn" is said of turns to both sides.
    """

    names: tuple[str, ...]
    of_clip: Index
    said: Bools

    def specific(self, texts: Sequence[int]) -> list[int]:
        """Those of a clip's sentences that say most: carried by the fewest meanings."""
        spread = self.said[list(texts)].sum(1)
        return [text for text, count in zip(texts, spread, strict=True) if count == spread.min()]


def meanings_of(material: Material) -> Meanings:
    """Meanings of all clips of a material."""
    labels = [
        meaning(action, [material.sentences[row] for row in texts])
        for action, texts in zip(material.actions, material.texts, strict=True)
    ]
    names = tuple(sorted(set(labels)))
    of_clip = np.array([names.index(label) for label in labels])
    said = np.zeros((len(material.sentences), len(names)), np.bool_)
    for number, texts in zip(of_clip, material.texts, strict=True):
        said[list(texts), number] = True
    return Meanings(names, of_clip, said)


def meaning(action: str, texts: Sequence[str]) -> str:
    """Action and the side that the sentences name more often, if they name one."""
    side = side_of(texts)
    return f"{action}:{side}" if side else action


def side_of(texts: Sequence[str]) -> str:
    """`left`, `right`, or nothing where the sentences name neither, or both as often."""
    left, right = (sum(bool(word.search(text)) for text in texts) for word in _SIDES.values())
    return "left" if left > right else "right" if right > left else ""
