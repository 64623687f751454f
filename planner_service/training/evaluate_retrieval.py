"""Held-out motion gone on with from its text, judged by the frozen evaluator: R-precision, FID and the rest.

The planner is given the first second of a held-out clip and a sentence of that clip, and goes on alone, its own motion
its next prefix, for as long as the clip does (2 to 5 s). Judged is what follows the given second, against what the
recording did there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from planner_service.training.dataset import Material
from planner_service.training.evaluate_quality import quality, within_bounds
from planner_service.training.evaluator.meanings import Meanings, meanings_of
from planner_service.training.evaluator.pairs import Pairs, fixed_pairs
from planner_service.training.evaluator.scores import (
    DRAWS,
    TOP,
    diversity,
    draw_pools,
    fid,
    multimodal_distance,
    other_meaning,
    r_precision,
)
from planner_service.training.evaluator.weights import Evaluator
from planner_service.training.rollout import Rollout
from shared.data.texts import PARAPHRASES, sentences
from shared.motion.features import features_to_global, global_to_features
from shared.motion.metrics import limb_speed_mps
from shared.plugins.interfaces import Planner
from shared.protocol.rates import PLANNER_FPS as FPS
from shared.tasks.interface import PlanGoal

Array = npt.NDArray[np.float64]
Advance = Callable[[int], None]

BATCH = 32
WHOLE_PLAN = 40


@dataclass(frozen=True)
class Heldout:
    """What everything is judged against: fixed held-out pairs and their embeddings.

    Attributes:
        texts: of every pair; truth: positions (P + T_i, 22, 3) of every pair, the prefix included.
        motion, sentence: (N, E) embeddings of the recordings and of the sentences.
        pools: (N, draws, pool - 1) from `draw_pools`.
    """

    material: Material
    meanings: Meanings
    pairs: Pairs
    texts: tuple[str, ...]
    truth: tuple[Array, ...]
    motion: Array
    sentence: Array
    pools: npt.NDArray[np.int64]
    prefix: int
    seed: int

    @classmethod
    def of(cls, material: Material, evaluator: Evaluator, prefix: int, seed: int, most: int | None = None) -> Heldout:
        """The pairs of a held-out material, or `most` of them, spread over it."""
        meanings = meanings_of(material)
        pairs = fixed_pairs(material, meanings, prefix, seed)
        if most is not None and most < len(pairs.clip):
            pairs = pairs.some(np.linspace(0, len(pairs.clip) - 1, most).round().astype(np.int64))
        texts = tuple(material.sentences[row] for row in pairs.sentence)
        truth = tuple(
            features_to_global(material.features[b - prefix : b + n], FPS)
            for b, n in zip(pairs.begin, pairs.frames, strict=True)
        )
        return cls(
            material=material,
            meanings=meanings,
            pairs=pairs,
            texts=texts,
            truth=truth,
            motion=evaluator.embed_motions(pairs.motions(material)),
            sentence=evaluator.embed_texts(texts),
            pools=draw_pools(other_meaning(pairs.meaning), pairs.meaning, DRAWS, np.random.default_rng(seed)),
            prefix=prefix,
            seed=seed,
        )

    def paraphrases(self) -> tuple[list[int], list[str]]:
        """Pairs whose action has held-out paraphrases, and one of them for each, with the clip's side."""
        rng = np.random.default_rng(self.seed)
        rows, texts = [], []
        for row, number in enumerate(self.pairs.meaning):
            action, _, side = self.meanings.names[number].partition(":")
            if action in PARAPHRASES and (found := sentences(action, side, PARAPHRASES)):
                rows.append(row)
                texts.append(str(rng.choice(found)))
        return rows, texts


def continued(
    planner: Planner,
    heldout: Heldout,
    rows: Sequence[int],
    texts: Sequence[str],
    seed: int,
    replan_frames: int = WHOLE_PLAN,
    prefix_noise_m: float = 0.0,
    advance: Advance = lambda count: None,
) -> list[Array]:
    """What a planner makes of the prefixes of pairs `rows`, with a text for each: positions (P + T_i, 22, 3)."""
    out: list[Array] = []
    for at in range(0, len(rows), BATCH):
        part = rows[at : at + BATCH]
        start = np.stack([heldout.truth[row][: heldout.prefix] for row in part])
        rollout = Rollout(planner, start, seed + 1000 * at, replan_frames, prefix_noise_m)
        wanted = [len(heldout.truth[row]) for row in part]
        while rollout.lengths()[0] < max(wanted):
            rollout.step(lambda body, view: PlanGoal(text=texts[at + body]))  # noqa: B023 - used at once
        out += [rollout.frames(body)[:frames] for body, frames in enumerate(wanted)]
        advance(len(part))
    return out


def embedded(evaluator: Evaluator, motions_w_m: Sequence[Array], skip: int) -> Array:
    """(N, E) embeddings of motions (T_i, 22, 3) at 20 fps without their first `skip` frames."""
    return evaluator.embed_motions([global_to_features(motion, FPS)[skip:] for motion in motions_w_m])


def retrieval(heldout: Heldout, motion: Array, rows: Sequence[int] | None = None) -> dict[str, object]:
    """Scores of embeddings (N, E) that stand for the recordings of pairs `rows` (all of them by default).

    A pool's other candidates are always all pairs' sentences.
    """
    chosen = np.arange(len(heldout.texts)) if rows is None else np.asarray(rows)
    found = r_precision(motion, heldout.sentence[chosen], heldout.sentence, heldout.pools[chosen])
    return {
        "r_precision": [round(float(x), 4) for x in found],
        "fid": fid(motion, heldout.motion[chosen]),
        "multimodal_distance": multimodal_distance(motion, heldout.sentence[chosen]),
        "diversity": diversity(motion, np.random.default_rng(heldout.seed)),
    }


def by_meaning(heldout: Heldout, motion: Array, made: Sequence[Array]) -> dict[str, dict[str, object]]:
    """R-precision (top 3) and speed of limbs of every meaning beside the recordings', with how many pairs it has.

    Args:
        motion: (N, E) embeddings of what was made of every pair. made: that, positions (P + T_i, 22, 3).
    """
    skip = heldout.prefix - 1
    speeds = [[limb_speed_mps(clip[skip:], FPS) for clip in clips] for clips in (made, heldout.truth)]
    out: dict[str, dict[str, object]] = {}
    for number in np.unique(heldout.pairs.meaning):
        rows = np.flatnonzero(heldout.pairs.meaning == number)
        found, true = (
            r_precision(these[rows], heldout.sentence[rows], heldout.sentence, heldout.pools[rows])[-1]
            for these in (motion, heldout.motion)
        )
        ours, theirs = (float(np.mean([each[row] for row in rows])) for each in speeds)
        out[heldout.meanings.names[number]] = {
            "n": len(rows), "r_precision_top3": round(float(found), 3), "ground_truth": round(float(true), 3),
            "limb_speed_mps": round(ours, 3), "ground_truth_limb_speed_mps": round(theirs, 3),
        }  # fmt: skip
    return out


def judged(
    evaluator: Evaluator,
    heldout: Heldout,
    planner: Planner,
    seed: int,
    replan_frames: int = WHOLE_PLAN,
    prefix_noise_m: float = 0.0,
    advance: Advance = lambda count: None,
) -> tuple[dict[str, object], list[Array]]:
    """Retrieval scores and quality of a planner's continuations beside the recordings', and those motions.

    Returns:
        fields of DESIGN 8, `chance` and `ground_truth` with the same fields; FID of the recordings is that of one half
        of them against the other, which is what counts so few motions alone make of it.
    """
    every = list(range(len(heldout.texts)))
    made = continued(planner, heldout, every, heldout.texts, seed, replan_frames, prefix_noise_m, advance)
    motion = embedded(evaluator, made, heldout.prefix)
    skip = heldout.prefix - 1
    plain = quality([clip[skip:] for clip in made])
    true = quality([clip[skip:] for clip in heldout.truth])
    width = heldout.pools.shape[-1] + 1
    return {
        "motions": len(every),
        "pool": width,
        **retrieval(heldout, motion),
        **plain,
        "within_bounds": within_bounds(plain, true),
        "chance": {"r_precision": [round(k / width, 4) for k in range(1, TOP + 1)]},
        "ground_truth": {**retrieval(heldout, heldout.motion), "fid": _split_fid(heldout), **true},
        "by_meaning": by_meaning(heldout, motion, made),
    }, made


def paraphrased(
    evaluator: Evaluator,
    heldout: Heldout,
    planner: Planner,
    made: Sequence[Array],
    seed: int,
    advance: Advance = lambda count: None,
) -> dict[str, object]:
    """R-precision of what is made from held-out paraphrases, and of what the corpus' sentences gave, on the same pairs.

    Both are judged by the corpus' sentences, so that the planner's understanding is measured and not the evaluator's.

    Args:
        made: of every pair, from `judged`.
    """
    rows, texts = heldout.paraphrases()
    if not rows:
        return {}
    other = continued(planner, heldout, rows, texts, seed, advance=advance)
    told = retrieval(heldout, embedded(evaluator, other, heldout.prefix), rows)
    trained = retrieval(heldout, embedded(evaluator, [made[row] for row in rows], heldout.prefix), rows)
    return {
        "paraphrase_r_precision": told["r_precision"],
        "paraphrase_training_r_precision": trained["r_precision"],
        "paraphrases": len(rows),
    }


def _split_fid(heldout: Heldout) -> float:
    order = np.random.default_rng(heldout.seed).permutation(len(heldout.motion))
    return fid(heldout.motion[order[::2]], heldout.motion[order[1::2]])
