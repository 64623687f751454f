"""`eval tracker --suite`: what following recorded clips does not show: standing still, pushes, seats.

stand: a minute on the spot, drift of the pelvis and jitter of the joints. pushes: impulses at the pelvis from 16 sides,
standing and walking, and who is still up three seconds later. seats: held-out clips that sit down, sit or rise. falls:
who of those knocked over gets up.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from shared.data.corpus import Corpus
from shared.errors import InvalidInputError
from shared.motion.ik import standing_clip
from shared.protocol.rates import TICK_HZ
from tracker_service.simulation.humanoid import Humanoid
from tracker_service.training.dataset import MotionInput, ReferenceSet, prepare, seat_in
from tracker_service.training.env import TrackingEnv
from tracker_service.training.env_settings import EnvSettings
from tracker_service.training.evaluate import evaluate
from tracker_service.training.falls import falls, library_of, upright_references
from tracker_service.training.knocks import long_walks, push

F32 = npt.NDArray[np.float32]
Floats = npt.NDArray[np.float64]
Policy = Callable[[F32], F32]

SUITES = ("stand", "pushes", "seats", "falls")
FALLS, SEED = 200, 1001
STAND_S = 60.0
SETTLE_S = 2.0
PUSHES_NS = (10.0, 20.0, 40.0)
DIRECTIONS = 16
PUSH_TICK = 45
AFTER_PUSH_S = 3.0
SEAT_BANDS_M = (0.0, 0.3, 0.4, 0.5, 0.6, 1.0)


def jitter_mps2(pos_w_m: npt.NDArray[np.floating]) -> float:
    """Root mean square of the joints' accelerations (m/s^2) of motion (T, J, 3) at 30 Hz: what trembling is made of."""
    acceleration = np.diff(np.asarray(pos_w_m, dtype=np.float64), n=2, axis=0) * TICK_HZ**2
    return float(np.sqrt(np.mean(np.sum(acceleration**2, axis=-1))))


def stand(human: Humanoid, settings: EnvSettings, policy: Policy, corpus: Corpus | None) -> dict[str, Any]:
    """A minute of standing: largest drift of the pelvis after the first two seconds, jitter, and whether it fell.

    With a corpus, `idle_jitter_p95_mps2` is the 95th percentile of its recorded standing.
    """
    ticks = round(STAND_S * TICK_HZ)
    references = prepare(human, [MotionInput("stand", "stand", 1.0, standing_clip(ticks + 10, TICK_HZ).positions_w_m)])
    env = TrackingEnv(human, references, settings.model_copy(update={"envs": 1}), seed=0)
    observation = env.start_at(np.zeros(1, dtype=np.int64))
    did = []
    for _ in range(ticks):
        env.advance(policy(observation))
        did.append(env.bodies().pos_w_m[0].copy())
        observation = env.observe()
    env.close()
    motion = np.stack(did)[round(SETTLE_S * TICK_HZ) :]
    drift = np.linalg.norm(motion[:, 0, :2] - motion[0, 0, :2], axis=-1)
    out: dict[str, Any] = {
        "seconds": STAND_S,
        "drift_m": float(drift.max()),
        "jitter_mps2": jitter_mps2(motion),
        "fell": bool(_low(human, motion[:, None]).any()),
    }
    if corpus is not None:
        idle = [
            jitter_mps2(corpus.positions(i))
            for i, clip in enumerate(corpus.clips)
            if clip.behaviour == "stand" and not clip.made and not clip.mirrored
        ]
        if idle:
            out["idle_jitter_p95_mps2"] = float(np.percentile(idle, 95))
    return out


def _low(human: Humanoid, pos_w_m: npt.NDArray[np.floating]) -> npt.NDArray[np.bool_]:
    """(..., B) whether heads of motion (..., B, J, 3) are below half their standing height."""
    head = human.skeleton.index("head")
    return np.asarray(pos_w_m[..., head, 2] < 0.5 * float(human.skeleton.rest_positions_m[head, 2]))


def pushes(human: Humanoid, settings: EnvSettings, policy: Policy, corpus: Corpus | None) -> dict[str, Any]:
    """Share of humanoids that are up three seconds after a push, by impulse, standing and (with a corpus) walking.

    Up means: the head never below half its standing height.
    """
    after = round(AFTER_PUSH_S * TICK_HZ)
    kinds = {"standing": [MotionInput("stand", "stand", 1.0, standing_clip(300, TICK_HZ).positions_w_m)]}
    if corpus is not None:
        kinds["walking"] = long_walks(corpus, PUSH_TICK + after + 10)
    out: dict[str, Any] = {}
    for kind, motions in kinds.items():
        references = prepare(human, motions)
        angles = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
        clips, directions, sizes = (
            a.ravel() for a in np.meshgrid(np.arange(len(motions)), angles, np.array(PUSHES_NS), indexing="ij")
        )
        env = TrackingEnv(human, references, settings.model_copy(update={"envs": len(clips)}), seed=0)
        observation = env.start_at(clips.astype(np.int64))
        down = np.zeros(len(clips), dtype=bool)
        for tick in range(PUSH_TICK + after):
            if tick == PUSH_TICK:
                vectors = np.stack([np.cos(directions), np.sin(directions), np.zeros(len(clips))], axis=-1)
                push(env, np.arange(len(clips)), vectors * sizes[:, None])
                observation = env.observe()
            env.advance(policy(observation))
            down |= _low(human, env.bodies().pos_w_m)
            observation = env.observe()
        env.close()
        out[kind] = {
            f"{size:g}_ns": {"n": int((sizes == size).sum()), "survived": float(1.0 - down[sizes == size].mean())}
            for size in PUSHES_NS
        }
    return out


def seats(human: Humanoid, settings: EnvSettings, policy: Policy, corpus: Corpus | None) -> dict[str, Any]:
    """Held-out clips with a seat, by behaviour and by the seat's height; success as for other clips."""
    motions = [
        MotionInput(clip.name, clip.behaviour, 1.0, corpus.positions(i), seat_in(clip))
        for i, clip in enumerate(corpus.clips if corpus is not None else ())
        if corpus is not None and clip.split == "heldout" and not clip.mirrored and seat_in(clip)[2] > 0
    ]
    if not motions:
        raise InvalidInputError("no held-out clip with a seat", field="corpus", allowed="a corpus with seats")
    references: ReferenceSet = prepare(human, motions)
    result = evaluate(settings, references, human, policy)
    heights = np.array([m.seat[2] for m in motions])
    ok = np.array([row["success"] for row in result["per_clip"]])
    result["by_height"] = {
        f"{low:g}-{high:g}": {"clips": int(inside.sum()), "success": float(ok[inside].mean())}
        for low, high in zip(SEAT_BANDS_M[:-1], SEAT_BANDS_M[1:], strict=True)
        if (inside := (heights >= low) & (heights < high)).any()
    }
    return result


def get_ups(human: Humanoid, settings: EnvSettings, policy: Policy, corpus: Corpus | None) -> dict[str, Any]:
    """FALLS bodies knocked over, and the share of them that get up by the corpus' get-ups; see `training.falls`."""
    library = [] if corpus is None else library_of(corpus, "train")
    if not library:
        raise InvalidInputError("no get-up in the corpus", field="corpus", allowed="a corpus with get-ups")
    return falls(human, settings, policy, upright_references(human, corpus), library, FALLS, SEED)


def run_suite(
    name: str, human: Humanoid, settings: EnvSettings, policy: Policy, corpus: Corpus | None
) -> dict[str, Any]:
    """Result of a suite by name; see the functions."""
    suites = {"stand": stand, "pushes": pushes, "seats": seats, "falls": get_ups}
    if name not in suites:
        raise InvalidInputError(f"unknown suite {name!r}", field="suite", allowed=", ".join(SUITES))
    return suites[name](human, settings, policy, corpus)
