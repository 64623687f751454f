"""The sentences that the shipped weights were trained on, and which of them a text is taken for.

Distance is by embedding and not by vocabulary: "somebody dashes" is near to "someone runs" although they share no word.
Each sentence is kept as the mean over its tokens' features (the pooled token of `text.encoder`), made by
`python -m planner_service.training.sentences`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from planner_service.text.encoder import TextEncoder
from planner_service.text.meaning import MeaningHead
from shared.errors import InvalidInputError

SHIPPED_SENTENCES = Path(__file__).resolve().parent.parent / "weights" / "sentences.npz"
UNLIKE_BELOW = 0.4
"""A text with a cosine below this is about something else, whatever it is taken to mean."""
ON_FOOT, ON_FOOT_LIKELY, ELSE_AT_MOST = ("walk", "run"), 0.75, 0.9
"""Ways are gone in so many places that a text of one may seem to be about something else ("walk the dog to the park"):
where that is at most so likely, and so much of the rest is a walk, or a run, it is one all the same."""
STOPS, GOING = ("walk_stop", "run_stop"), re.compile(r"\b(walk|stroll|stride|march|run|jog|sprint|dash)")
"""Recorded stops begin with a walk or a run: who is told to stop and not to go on before is told to stand."""
SAME_ABOVE = 0.9
"""A cosine above this is a trained sentence in other words: such a text is planned for as it is."""


@dataclass(frozen=True)
class Nearest:
    """A training sentence and the cosine (at most 1) of its embedding with the text's.

    Attributes:
        far: whether the text is about something else than all that was trained, or means what no trained sentence does.
        taken_as: the training sentence that is planned for in place of the text; None where that is the text itself.
        meaning: of the text, a name of the head's; None without a head or where the text is far.
    """

    sentence: str
    similarity: float
    far: bool = False
    taken_as: str | None = None
    meaning: str | None = None


class KnownSentences:
    """Training sentences with their embeddings.

    Args:
        sentences: N of them.
        embeddings: (N, D), any length.
        encoder: name of the encoder that made them.
        meanings: of each sentence one or more of the head's, or none.
        head: what a text means; without it texts are planned for as they are, and none is far.
    """

    def __init__(
        self,
        sentences: tuple[str, ...],
        embeddings: npt.NDArray[np.floating],
        encoder: str,
        meanings: Sequence[Sequence[str]] = (),
        head: MeaningHead | None = None,
    ):
        self.sentences = sentences
        self.encoder = encoder
        self.head = head
        self._meanings = tuple(tuple(each) for each in meanings) or ((),) * len(sentences)
        self._unit = _unit(np.asarray(embeddings, dtype=np.float32))
        self._of: Mapping[str, npt.NDArray[np.intp]] = {
            meaning: np.array([i for i, each in enumerate(self._meanings) if meaning in each])
            for meaning in {name for each in self._meanings for name in each}
        }

    @classmethod
    def load(cls, path: Path = SHIPPED_SENTENCES, head: MeaningHead | None = None) -> KnownSentences:
        """From a file of `save`."""
        with np.load(path, allow_pickle=False) as data:
            meanings = [str(each).split() for each in data["meanings"]]
            return cls(
                tuple(str(s) for s in data["sentences"]), data["embeddings"], str(data["encoder"]), meanings, head
            )

    def save(self, path: Path) -> None:
        """Write sentences, their meanings and embeddings (float16)."""
        np.savez_compressed(
            path,
            sentences=np.array(self.sentences),
            embeddings=self._unit.astype(np.float16),
            encoder=np.array(self.encoder),
            meanings=np.array([" ".join(each) for each in self._meanings]),
        )

    def nearest(self, text: str, encoder: TextEncoder) -> Nearest:
        """The sentence nearest to a text, and the one it is taken for: the nearest of those that mean the same.

        Neither a text that says almost what a sentence does nor one that is far from all is taken for another.

        Raises:
            InvalidInputError: another encoder than the one that made them.
        """
        if encoder.spec.name != self.encoder:
            raise InvalidInputError(
                f"these sentences were embedded by another encoder than {encoder.spec.name!r}",
                field="text_encoder",
                allowed=self.encoder,
            )
        plain = " ".join(text.strip().rstrip(".!").lower().split())
        embedding = _unit(encoder.encode([plain])[0][0])
        cosines = self._unit @ embedding
        best = int(np.argmax(cosines))
        similarity = float(min(cosines[best], 1.0))
        if self.head is None:
            return Nearest(self.sentences[best], similarity)
        meaning = None
        if similarity >= UNLIKE_BELOW:
            meaning = self.head.most_likely(plain) or _on_foot(self.head, plain)
        if meaning in STOPS and not GOING.search(plain):
            meaning = "stand"
        said = similarity >= SAME_ABOVE
        taken_as = None
        if not said and meaning is not None:
            same = self._of.get(meaning)
            if same is None:  # told apart by its words, but no motion that was trained shows it
                meaning = None
            else:
                taken_as = self.sentences[int(same[np.argmax(cosines[same])])]
        return Nearest(self.sentences[best], similarity, not said and meaning is None, taken_as, meaning)


def _on_foot(head: MeaningHead, text: str) -> str | None:
    *shares, other = head.shares(text)
    for way in ON_FOOT:
        on_it = sum(s for name, s in zip(head.names, shares, strict=True) if name.split(":")[0].split("_")[0] == way)
        if other <= ELSE_AT_MOST and on_it >= ON_FOOT_LIKELY * (1.0 - other):
            return way
    return None


def _unit(rows: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    return np.asarray(rows / np.maximum(np.linalg.norm(rows, axis=-1, keepdims=True), 1e-9), dtype=np.float32)
