"""The sentences that the shipped weights were trained on, and which of them is nearest to a text.

Distance is by embedding and not by vocabulary: "somebody dashes" is near to "someone runs" although they share no word.
Each sentence is kept as the mean over its tokens' features (the pooled token of `text.encoder`), made by
`python -m planner_service.training.sentences`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from planner_service.text.encoder import TextEncoder
from shared.errors import InvalidInputError

SHIPPED_SENTENCES = Path(__file__).resolve().parent.parent / "weights" / "sentences.npz"
FAR_BELOW = 0.52
"""A cosine below this is far: most paraphrases of what is trained lie above 0.55, most other activities below 0.45
(`tests/planner/test_known_sentences.py` has both)."""


@dataclass(frozen=True)
class Nearest:
    """A training sentence and the cosine (at most 1) of its embedding with the text's."""

    sentence: str
    similarity: float

    @property
    def far(self) -> bool:
        """Whether the text is unlike all that was trained."""
        return self.similarity < FAR_BELOW


class KnownSentences:
    """Training sentences with their embeddings.

    Args:
        sentences: N of them.
        embeddings: (N, D), any length.
        encoder: name of the encoder that made them.
    """

    def __init__(self, sentences: tuple[str, ...], embeddings: npt.NDArray[np.floating], encoder: str):
        self.sentences = sentences
        self.encoder = encoder
        self._unit = _unit(np.asarray(embeddings, dtype=np.float32))

    @classmethod
    def load(cls, path: Path = SHIPPED_SENTENCES) -> KnownSentences:
        """From a file of `save`."""
        with np.load(path, allow_pickle=False) as data:
            return cls(tuple(str(s) for s in data["sentences"]), data["embeddings"], str(data["encoder"]))

    def save(self, path: Path) -> None:
        """Write sentences and embeddings (float16)."""
        np.savez_compressed(
            path,
            sentences=np.array(self.sentences),
            embeddings=self._unit.astype(np.float16),
            encoder=np.array(self.encoder),
        )

    def nearest(self, text: str, encoder: TextEncoder) -> Nearest:
        """The sentence nearest to a text. Raises InvalidInputError for another encoder than the one that made them."""
        if encoder.spec.name != self.encoder:
            raise InvalidInputError(
                f"these sentences were embedded by another encoder than {encoder.spec.name!r}",
                field="text_encoder",
                allowed=self.encoder,
            )
        plain = " ".join(text.strip().rstrip(".!").lower().split())
        cosines = self._unit @ _unit(encoder.encode([plain])[0][0])
        best = int(np.argmax(cosines))
        return Nearest(self.sentences[best], float(min(cosines[best], 1.0)))


def _unit(rows: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    return np.asarray(rows / np.maximum(np.linalg.norm(rows, axis=-1, keepdims=True), 1e-9), dtype=np.float32)
