"""Recorded episodes judged as plans are: the closed loop beside the recordings and beside DiP alone.

A recording is a .npz as episodes are exported (docs/exports.md), or as `eval text --record` writes: `body_pos_w_m`
(T, 22, 3) and `fps`. What it was told is in its array `text`, or in a file of the same stem ending in .txt: lines of a
second, a tab and a sentence that holds from there on.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from planner_service.training.evaluate_quality import quality
from planner_service.training.evaluate_retrieval import BATCH, WHOLE_PLAN, Heldout
from planner_service.training.evaluator.pairs import LEAST, MOST
from planner_service.training.evaluator.scores import (
    DRAWS,
    diversity,
    draw_pools,
    fid,
    multimodal_distance,
    r_precision,
)
from planner_service.training.evaluator.weights import Evaluator
from planner_service.training.rollout import Rollout
from shared.data.texts import clean
from shared.errors import InvalidInputError
from shared.motion.features import global_to_features
from shared.motion.ik import standing_clip
from shared.motion.resampling import resample
from shared.plugins.interfaces import Planner
from shared.protocol.rates import PLANNER_FPS as FPS
from shared.tasks.interface import PlanGoal

Array = npt.NDArray[np.float64]
Advance = Callable[[int], None]

ALIKE = 0.7
"""Sentences whose embeddings have a cosine above this mean the same, where one is not of the held-out clips."""


@dataclass(frozen=True)
class Told:
    """What a body did while a sentence held: positions (T, 22, 3) at 20 fps, cut to 5 s."""

    text: str
    positions_w_m: Array


def read_recorded(folder: Path) -> list[Told]:
    """All stretches of at least 2 s under one sentence, of all recordings in a folder and below, by name.

    Raises:
        InvalidInputError: there is none, or a file holds no motion, or nothing says what it was told.
    """
    out: list[Told] = []
    files = sorted(folder.rglob("*.npz"))
    for file in files:
        with np.load(file, allow_pickle=False) as data:
            if "body_pos_w_m" not in data or "fps" not in data:
                raise InvalidInputError(f"{file} is no recording", field="recorded", allowed="body_pos_w_m and fps")
            positions, fps = np.asarray(data["body_pos_w_m"], dtype=np.float64), float(data["fps"])
            lines = [(0.0, str(data["text"]))] if "text" in data else _lines(file.with_suffix(".txt"))
        ends = [second for second, _ in lines[1:]] + [len(positions) / fps]
        for (begin, text), end in zip(lines, ends, strict=True):
            rows = positions[round(begin * fps) : round(end * fps)]
            if len(rows) < fps * LEAST / FPS:
                continue
            out.append(Told(text, resample(rows, fps, FPS)[:MOST]))
    if not out:
        raise InvalidInputError(
            f"{folder} holds no recording of {LEAST / FPS:g} s under one sentence",
            field="recorded",
            allowed=".npz files",
        )
    return out


def judged_recorded(
    evaluator: Evaluator,
    heldout: Heldout,
    recorded: Sequence[Told],
    planner: Planner,
    seed: int,
    advance: Advance = lambda count: None,
) -> dict[str, object]:
    """The table: `ground_truth` (held-out recordings), `dip_alone` and `closed_loop`, each with the same fields.

    DiP alone is told the sentences that the recordings were told, for as long, from standing.
    """
    texts = [told.text for told in recorded]
    alone = _alone(planner, texts, [len(told.positions_w_m) for told in recorded], seed, advance)
    sentence = evaluator.embed_texts(texts)
    pools = draw_pools(_differs(heldout, texts, sentence), heldout.pairs.meaning, DRAWS, np.random.default_rng(seed))

    def column(clips: Sequence[Array]) -> dict[str, object]:
        motion = evaluator.embed_motions([global_to_features(clip, FPS) for clip in clips])
        found = r_precision(motion, sentence, heldout.sentence, pools)
        return {
            "r_precision": [round(float(x), 4) for x in found],
            "fid": fid(motion, heldout.motion),
            "multimodal_distance": multimodal_distance(motion, sentence),
            "diversity": diversity(motion, np.random.default_rng(seed)),
            **quality(clips),
        }

    found = r_precision(heldout.motion, heldout.sentence, heldout.sentence, heldout.pools)
    skip = heldout.prefix - 1
    truth = {
        "r_precision": [round(float(x), 4) for x in found],
        "fid": 0.0,
        "multimodal_distance": multimodal_distance(heldout.motion, heldout.sentence),
        "diversity": diversity(heldout.motion, np.random.default_rng(seed)),
        **quality([clip[skip:] for clip in heldout.truth]),
    }
    return {
        "stretches": len(recorded),
        "pool": pools.shape[-1] + 1,
        "ground_truth": truth,
        "dip_alone": column(alone),
        "closed_loop": column([told.positions_w_m for told in recorded]),
    }


def _differs(heldout: Heldout, texts: Sequence[str], sentence: Array) -> npt.NDArray[np.bool_]:
    """(N, pairs) whether a held-out pair means something else than each text."""
    out = sentence @ heldout.sentence.T <= ALIKE
    number = {text: row for row, text in enumerate(heldout.material.sentences)}
    for row, text in enumerate(texts):
        known = [number[same] for same in clean([text]) if same in number]
        if known:
            out[row] = ~heldout.meanings.said[known[0]][heldout.pairs.meaning]
    return out


def _alone(planner: Planner, texts: Sequence[str], frames: Sequence[int], seed: int, advance: Advance) -> list[Array]:
    prefix = planner.spec.prefix_frames
    standing = standing_clip(prefix, FPS).positions_w_m
    out: list[Array] = []
    for at in range(0, len(texts), BATCH):
        part, wanted = texts[at : at + BATCH], frames[at : at + BATCH]
        rollout = Rollout(planner, np.repeat(standing[None], len(part), 0), seed + 1000 * at, WHOLE_PLAN)
        while rollout.lengths()[0] < prefix + max(wanted):
            rollout.step(lambda body, view: PlanGoal(text=part[body]))  # noqa: B023 - used at once
        out += [rollout.frames(body)[prefix : prefix + count] for body, count in enumerate(wanted)]
        advance(len(part))
    return out


def _lines(path: Path) -> list[tuple[float, str]]:
    if not path.is_file():
        raise InvalidInputError(f"nothing says what {path.stem} was told", field="recorded", allowed=f"{path}")
    out = []
    for line in path.read_text(encoding="utf-8").splitlines():
        second, tab, text = line.partition("\t")
        try:
            out.append((float(second), text.strip()))
        except ValueError:
            tab = ""
        if not tab:
            raise InvalidInputError(f"{path}: {line!r}", field="recorded", allowed="SECOND, tab, sentence")
    if not out:
        raise InvalidInputError(f"{path} is empty", field="recorded", allowed="SECOND, tab, sentence")
    return out
