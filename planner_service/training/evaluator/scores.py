"""What the field measures motion by, on embeddings: R-precision, FID, multimodal distance, diversity.

As Guo et al. (2022) define them.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from shared.errors import InvalidInputError

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]

POOL = 32
TOP = 3
DRAWS = 20
"""Pools drawn for each motion: which others are in a pool is chance, and costs nothing to average out."""


def draw_pools(
    differs: npt.NDArray[np.bool_], meaning: Index, draws: int, rng: np.random.Generator, size: int = POOL
) -> Index:
    """For each of N motions `draws` pools of other motions' sentences, every one of another meaning.

    Args:
        differs: (N, M) whether sentence j means something else than motion i.
        meaning: (M,) of the sentences.
        size: of a pool, the motion's own sentence included; smaller where there are not so many meanings.

    Returns:
        (N, draws, P - 1) rows of the sentences.

    Raises:
        InvalidInputError: nothing differs from one of the motions.
    """
    kinds = [[np.flatnonzero(row & (meaning == m)) for m in np.unique(meaning[row])] for row in differs]
    width = min([size - 1, *(len(groups) for groups in kinds)])
    if width < 1:
        raise InvalidInputError("a pool needs sentences of another meaning", field="samples")
    out = np.zeros((len(differs), draws, width), np.int64)
    for i, groups in enumerate(kinds):
        for d in range(draws):
            chosen = rng.permutation(len(groups))[:width]
            out[i, d] = [groups[k][rng.integers(len(groups[k]))] for k in chosen]
    return out


def other_meaning(meaning: Index) -> npt.NDArray[np.bool_]:
    """(N, N) whether two samples differ in meaning (N,)."""
    return np.asarray(meaning[:, None] != meaning)


def r_precision(motion: Array, sentence: Array, others: Array, pools: Index, top: int = TOP) -> Array:
    """(top,) shares of pools in which the motion's own sentence is among the nearest 1 .. `top`.

    Args:
        motion, sentence: (N, E), row i of both of one pair.
        others: (M, E) sentences that pools are drawn from.
        pools: (N, draws, P - 1) rows of `others`, from `draw_pools`.
    """
    own = np.linalg.norm(sentence - motion, axis=-1)[:, None, None]
    distance = np.linalg.norm(others[pools] - motion[:, None, None], axis=-1)
    # Ties count against the sample: embeddings that are all alike find nothing.
    rank = (distance <= own).sum(-1)
    return np.array([(rank < k).mean() for k in range(1, top + 1)])


def fid(one: Array, other: Array) -> float:
    """Frechet distance of two sets (N, E), (M, E) as Gaussians: |m1 - m2|^2 + tr(C1 + C2 - 2 sqrt(C1 C2))."""
    gap = one.mean(0) - other.mean(0)
    c1, c2 = np.atleast_2d(np.cov(one, rowvar=False)), np.atleast_2d(np.cov(other, rowvar=False))
    # The eigenvalues of C1 C2 are those of the symmetric sqrt(C1) C2 sqrt(C1): real and not negative.
    values, vectors = np.linalg.eigh(c1)
    root = (vectors * np.sqrt(np.clip(values, 0.0, None))) @ vectors.T
    shared = np.sqrt(np.clip(np.linalg.eigvalsh(root @ c2 @ root), 0.0, None)).sum()
    return float(gap @ gap + np.trace(c1) + np.trace(c2) - 2.0 * shared)


def multimodal_distance(motion: Array, sentence: Array) -> float:
    """Mean distance of motions (N, E) to their own sentences (N, E)."""
    return float(np.linalg.norm(motion - sentence, axis=-1).mean())


def diversity(motion: Array, rng: np.random.Generator, pairs: int = 300) -> float:
    """Mean distance between two motions (N, E) drawn at random."""
    first, second = rng.integers(len(motion), size=pairs), rng.integers(len(motion), size=pairs)
    return float(np.linalg.norm(motion[first] - motion[second], axis=-1).mean())
