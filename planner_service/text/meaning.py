"""What an unseen sentence means: a linear head on its embedding, fitted to all that is written in shared/data.

A network that was shown a thousand sentences takes an unseen one for the nearest of them by its words, and is wrong in
one of five ("someone is waving" is nearer to "someone walks forward waving" than to "wave at somebody"). A head that
was fitted to many more sentences with their meanings knows which part of an embedding tells meanings apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float32]


@dataclass(frozen=True)
class MeaningHead:
    """Multinomial logistic regression over meanings.

    Attributes:
        names: M meanings, an action of shared/data with its side where it has one, e.g. `kick:left`.
        weights: (M, D), for embeddings of length 1. bias: (M,).
    """

    names: tuple[str, ...]
    weights: Floats
    bias: Floats

    def most_likely(self, embedding: Floats) -> str:
        """The meaning of an embedding (D,) of length 1."""
        return self.names[int(np.argmax(self.weights @ embedding + self.bias))]

    def shares(self, embedding: Floats) -> Floats:
        """(M,) how likely each meaning is."""
        logits = self.weights @ embedding + self.bias
        likely = np.exp(logits - logits.max())
        return np.asarray(likely / likely.sum(), dtype=np.float32)
