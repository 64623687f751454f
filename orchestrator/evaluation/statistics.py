"""Small statistics of the evaluations."""

from __future__ import annotations

from math import erfc, sqrt

import numpy as np
import numpy.typing as npt


def two_proportions_p(successes_a: int, n_a: int, successes_b: int, n_b: int) -> float:
    """p of two samples of one proportion differing so much, two-sided: the pooled z test; 1 where nothing differs."""
    pooled = (successes_a + successes_b) / (n_a + n_b)
    spread = sqrt(pooled * (1 - pooled) * (1 / n_a + 1 / n_b))
    return 1.0 if spread == 0 else erfc(abs(successes_a / n_a - successes_b / n_b) / spread / sqrt(2))


def percentiles(values: npt.ArrayLike, *which: float) -> dict[str, float | None]:
    """{"p50": ..., "p95": ...}; None where there are no values."""
    a = np.asarray(values, dtype=np.float64)
    return {f"p{q:g}": round(float(np.percentile(a, q)), 2) if a.size else None for q in which}
