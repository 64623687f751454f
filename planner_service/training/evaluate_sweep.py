"""Ablations that cost no training: steps of diffusion, guidance, noise on the prefix, replan period."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from planner_service.dip.planner import DipPlanner, DipSettings
from planner_service.training.evaluate_retrieval import WHOLE_PLAN, Heldout, judged
from planner_service.training.evaluator.weights import Evaluator
from shared.errors import InvalidInputError

Advance = Callable[[int], None]
FIELDS = (
    "r_precision",
    "fid",
    "multimodal_distance",
    "diversity",
    "penetration_mm",
    "floating_mm",
    "skating_mm",
    "jerk",
)


@dataclass(frozen=True)
class Variant:
    """One row: what differs from the planner as shipped, whose plans are played whole."""

    settings: dict[str, Any] = field(default_factory=dict)
    replan_frames: int = WHOLE_PLAN
    prefix_noise_m: float = 0.0


VARIANTS: dict[str, dict[str, Variant]] = {
    "shipped": {"as shipped, plans played whole": Variant()},
    "steps": {f"{n} steps": Variant({"steps": n}) for n in (3, 5, 10)},
    "guidance": {
        **{f"guidance {g:g}": Variant({"guidance": g}) for g in (1.0, 2.5, 5.0, 7.5)},
        "guidance 3 in every step": Variant({"coarse_guidance": 3.0}),
    },
    "noise": {f"prefix noise {mm:g} mm": Variant(prefix_noise_m=mm / 1000) for mm in (2.0, 5.0, 10.0)},
    "replan": {f"a new plan every {n / 20:g} s": Variant(replan_frames=n) for n in (10, 20, 30)},
}
"""Rows by what they vary; the first is what all others are to be compared with."""


def sweep(
    weights: Path,
    which: str,
    evaluator: Evaluator,
    heldout: Heldout,
    seed: int,
    stage: Callable[[str, int], Advance],
) -> list[dict[str, object]]:
    """Judge every variant on the same texts and noise.

    Args:
        which: `all`, or names of VARIANTS with commas.
        stage: gives what moves the progress of a row on.

    Returns:
        rows {variant, FIELDS, seconds}, `shipped` first.

    Raises:
        InvalidInputError: a name that is not known.
    """
    names = list(VARIANTS) if which == "all" else [name.strip() for name in which.split(",") if name.strip()]
    for name in names:
        if name not in VARIANTS:
            raise InvalidInputError(f"nothing to sweep named {name!r}", field="sweep", allowed=", ".join(VARIANTS))
    chosen = {
        label: variant for name in dict.fromkeys(["shipped", *names]) for label, variant in VARIANTS[name].items()
    }
    rows: list[dict[str, object]] = []
    for label, variant in chosen.items():
        planner = DipPlanner.load(weights, DipSettings(**variant.settings))
        advance = stage(label, len(heldout.texts))
        began = time.process_time()
        found, _ = judged(
            evaluator, heldout, planner, seed, variant.replan_frames, variant.prefix_noise_m, advance=advance
        )
        rows.append({"variant": label, **{name: found[name] for name in FIELDS},
                     "cpu_s": round(time.process_time() - began, 1)})  # fmt: skip
    return rows
