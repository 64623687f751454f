"""Falls: bodies knocked over while they stand or walk, lying as physics left them, and ways up from there.

A way up (`shared.motion.rise`) is a clip like any other: it begins in a pose in which a body really lies and ends in
standing, so that a tracker learns to get up by following it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
import typer

from shared.console import errors_for_people
from shared.data.corpus import Corpus
from shared.motion.heading import hips_heading
from shared.motion.ik import standing_clip, standing_pose
from shared.motion.kinematics import forward_kinematics
from shared.motion.rise import LOW_PELVIS_M, Rises, between
from shared.protocol.rates import TICK_HZ
from shared.statistics import wilson
from tracker_service.policy.learned import WEIGHTS
from tracker_service.simulation.character_spec import HUMAN
from tracker_service.simulation.humanoid import Humanoid, humanoid
from tracker_service.training.dataset import MotionInput, ReferenceSet, prepare
from tracker_service.training.env import SUBSTEPS, TrackingEnv
from tracker_service.training.env_settings import EnvSettings
from tracker_service.training.knocks import long_walks, push
from tracker_service.training.policies import policy_of
from tracker_service.training.seats import CONTROL_SPEC

F32 = npt.NDArray[np.float32]
Floats = npt.NDArray[np.float64]
Policy = Callable[[F32], F32]

GET_UP = "get_up"
PUSHES_NS = (150.0, 400.0)
PUSH_TICKS = (15, 75)
FIGHT_TICKS, LIMP_TICKS = 30, 60
"""After the push the policy fights for a second; then the servos give in, and the body comes to rest."""
LYING_PELVIS_M = 0.45
TO_STAND_TICKS = 18
BATCH = 128


def fall(
    human: Humanoid, references: ReferenceSet, settings: EnvSettings, policy: Policy, count: int, seed: int
) -> tuple[Floats, Floats]:
    """Knock humanoids over and let them come to rest.

    Half of them are pushed at the pelvis and resist; half go limp where they stand or walk.

    Returns:
        qpos (N, 7+H) and body positions (N, J, 3) of those, of `count`, that lie in the end.
    """
    rng = np.random.default_rng(seed)
    env = TrackingEnv(human, references, settings.model_copy(update={"envs": count}), seed=seed)
    observation = env.start_at(rng.integers(0, len(references), size=count))
    when = rng.integers(*PUSH_TICKS, size=count)
    angle, size = rng.uniform(0, 2 * np.pi, count), rng.uniform(*PUSHES_NS, size=count)
    limp = rng.random(count) < 0.5
    impulse = np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], axis=-1) * size[:, None]
    impulse[limp] *= 0.4
    for tick in range(max(PUSH_TICKS) + FIGHT_TICKS + LIMP_TICKS):
        pushed = np.flatnonzero(when == tick)
        if len(pushed):
            push(env, pushed, impulse[pushed])
            observation = env.observe()
        slack = np.greater_equal(tick, when) & (limp | np.greater_equal(tick, when + FIGHT_TICKS))
        # A servo that wants what is gives in: only its damping is left.
        target = np.where(slack[:, None], env.qpos[:, 7:], env.targets(policy(observation)))
        after = env.roll(env.state, np.repeat(env.control(target)[:, None], SUBSTEPS, axis=1), CONTROL_SPEC)[:, -1]
        sound = np.asarray(np.isfinite(after).all(axis=-1))
        env.state = np.where(sound[:, None], after, env.state)
        env.time += 1
        env.moved()
        observation = env.observe()
    pos = env.bodies().pos_w_m.astype(np.float64)
    down = pos[:, 0, 2] < LYING_PELVIS_M
    qpos = env.qpos[down].copy()
    env.close()
    return qpos, pos[down]


def ways_up(
    human: Humanoid, lying_w_m: Floats, library: Sequence[Floats], weight: float, name: str = "fall"
) -> list[MotionInput]:
    """A clip (behaviour `get_up`) for each body that lies, positions (N, J, 3), by get-ups (T, J, 3) at 30 Hz.

    Each ends in a second of standing still: recorded ways are cut where the body is up and still moves.
    """
    rises = Rises(library, TICK_HZ, human.skeleton)
    return [
        MotionInput(f"{name}/{i:04d}", GET_UP, weight, into_standing(human, rises.rise(pose)))
        for i, pose in enumerate(lying_w_m)
    ]


def into_standing(human: Humanoid, way_w_m: Floats) -> Floats:
    """A way up (T, J, 3) that goes on into standing where its feet are: TO_STAND_TICKS of slowing down, a second of
    rest."""
    skeleton, last = human.skeleton, way_w_m[-1]
    local = standing_pose(skeleton, float(hips_heading(last, skeleton)))
    root = np.array([[0.0, 0.0, skeleton.root_height_m]])
    stand = np.asarray(forward_kinematics(skeleton, root, local[None])[0])[0]
    ankles = [skeleton.index("left_ankle"), skeleton.index("right_ankle")]
    stand[:, :2] += (last[ankles] - stand[ankles])[:, :2].mean(axis=0)
    left = 1.0 - np.minimum(np.arange(1, TO_STAND_TICKS + TICK_HZ + 1) / TO_STAND_TICKS, 1.0)
    return np.concatenate([way_w_m, between(last, stand, 1.0 - left**2, skeleton)])


def low_enough(motion: Floats) -> bool:
    """Whether a motion (T, J, 3) is a way up: it begins low and ends standing."""
    return bool(motion[:, 0, 2].min() < LOW_PELVIS_M and motion[-1, 0, 2] > 0.8)


FOOT_DOWN_M = 0.12
UP_M, UP_TICKS, UP_WITHIN_S, STILL_UP_S = 0.8, 15, 6.0, 1.0


def got_up(pelvis_m: Floats, feet_down: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """(N,) whether bodies got up: pelvis at 0.8 m or more with both feet down for half a second, within six seconds,
    and still up a second later.

    Args:
        pelvis_m: (T, N) height. feet_down: (T, N) both feet near the floor.
    """
    up = (pelvis_m >= UP_M) & feet_down
    ticks = np.zeros(up.shape[1], dtype=int)
    out = np.zeros(up.shape[1], dtype=bool)
    later = round(STILL_UP_S * TICK_HZ)
    for tick in range(min(len(up), round(UP_WITHIN_S * TICK_HZ))):
        ticks = np.where(up[tick], ticks + 1, 0)
        out |= (ticks >= UP_TICKS) & (pelvis_m[min(tick + later, len(up) - 1)] >= UP_M)
    return out


def follow(
    human: Humanoid, settings: EnvSettings, policy: Policy, qpos: Floats, ways: Sequence[MotionInput], seed: int
) -> Floats:
    """What bodies do that start at rest in qpos (N, 7+H) and follow their ways up, while it counts: (T, N, J, 3)."""
    ticks = round((UP_WITHIN_S + STILL_UP_S) * TICK_HZ)
    references = prepare(human, [_held(way, ticks + 10) for way in ways])
    env = TrackingEnv(human, references, settings.model_copy(update={"envs": len(ways)}), seed=seed)
    env.start_at(np.arange(len(ways)))
    env.state[:, 1 : 1 + qpos.shape[1]] = qpos
    env.state[:, 1 + qpos.shape[1] :] = 0.0
    env.moved()
    observation = env.observe()
    did = []
    for _ in range(ticks):
        env.advance(policy(observation))
        did.append(env.bodies().pos_w_m.astype(np.float64))
        observation = env.observe()
    env.close()
    return np.stack(did)


def off_m(did_w_m: Floats, way: MotionInput) -> float:
    """Mean distance of a body's joints (T, J, 3) from its way up, from the first tick after its start to its end."""
    wanted = way.positions_w_m[1 : len(did_w_m) + 1]
    return float(np.linalg.norm(did_w_m[: len(wanted)] - wanted, axis=-1).mean())


def stands(human: Humanoid, did_w_m: Floats) -> npt.NDArray[np.bool_]:
    """(N,) who got up, of bodies that moved like this (T, N, J, 3); see `got_up`."""
    feet = [human.skeleton.index(n) for n in ("left_foot", "right_foot")]
    return got_up(did_w_m[:, :, 0, 2], np.asarray((did_w_m[:, :, feet, 2] < FOOT_DOWN_M).all(axis=-1)))


def falls(
    human: Humanoid, settings: EnvSettings, policy: Policy, standing: ReferenceSet, library: Sequence[Floats],
    count: int, seed: int,
) -> dict[str, Any]:  # fmt: skip
    """The suite `falls`: bodies that lie follow their way up; share of those that stand by `got_up`."""
    qpos, lying = fall(human, standing, settings, policy, count, seed)
    ok = stands(human, follow(human, settings, policy, qpos, ways_up(human, lying, library, 1.0), seed))
    facing = _facing(human, lying)
    return {
        "falls": len(ok),
        **_rate(ok),
        "by_facing": {
            side: {"n": int((facing == side).sum()), **_rate(ok[facing == side])}
            for side in ("up", "down", "side")
            if (facing == side).any()
        },
    }


def _rate(ok: npt.NDArray[np.bool_]) -> dict[str, Any]:
    return {"got_up": float(ok.mean()), "ci95": [round(v, 4) for v in wilson(int(ok.sum()), len(ok))]}


def _held(way: MotionInput, frames: int) -> MotionInput:
    rest = np.repeat(way.positions_w_m[-1:], max(frames - len(way.positions_w_m), 0), axis=0)
    return replace(way, positions_w_m=np.concatenate([way.positions_w_m, rest]))


def _facing(human: Humanoid, lying_w_m: Floats) -> npt.NDArray[np.str_]:
    """(N,) `up`, `down` or `side`: where the chest of lying bodies (N, J, 3) looks."""
    index = human.skeleton.index
    across = lying_w_m[:, index("left_shoulder")] - lying_w_m[:, index("right_shoulder")]
    along = lying_w_m[:, index("neck")] - lying_w_m[:, 0]
    chest = np.cross(across, along)
    vertical = chest[:, 2] / np.maximum(np.linalg.norm(chest, axis=-1), 1e-9)
    return np.where(vertical > 0.5, "up", np.where(vertical < -0.5, "down", "side"))


def library_of(corpus: Corpus, split: str) -> list[Floats]:
    """Recorded get-ups of a split, both sides; where there is none, made ones and lying down played backward.

    A body needs one way from its back and one from its face. Of 100 falls 42 of the 55 that took the recorded way from
    the face got up, 5 of the 15 from the back, and none of the 29 that took another: practice is better not spread.
    """
    recorded, others = [], []
    for i, clip in enumerate(corpus.clips):
        if clip.split == split and clip.behaviour in (GET_UP, "lie_down"):
            motion = np.asarray(corpus.positions(i), dtype=np.float64)
            ways = [way for way in (motion, motion[::-1]) if low_enough(way) and way[0, 0, 2] < LOW_PELVIS_M]
            if clip.behaviour == GET_UP and not clip.made:
                recorded += ways
            else:
                others += ways
    return recorded or others


def upright_references(human: Humanoid, corpus: Corpus | None) -> ReferenceSet:
    """What bodies do before they are knocked over: stand, and with a corpus walk (held-out recordings)."""
    motions = [MotionInput("stand", "stand", 1.0, standing_clip(300, TICK_HZ).positions_w_m)]
    return prepare(human, motions + ([] if corpus is None else long_walks(corpus, max(PUSH_TICKS) + 40)))


@dataclass(frozen=True)
class _Batch:
    """Bodies that lie: qpos (N, 7+H), positions (N, J, 3), and a way up for each."""

    qpos: Floats
    lying_w_m: Floats
    ways: list[MotionInput]


def _batches(
    human: Humanoid, settings: EnvSettings, policy: Policy, corpus: Path, count: int, seed: int
) -> Iterator[_Batch]:
    """Falls of a policy in batches, with ways up out of a corpus for those that lie in the end."""
    loaded = Corpus.load(corpus)
    library, upright = library_of(loaded, "train"), upright_references(human, loaded)
    for first in range(0, count, BATCH):
        qpos, lying = fall(human, upright, settings, policy, min(BATCH, count - first), seed + first)
        yield _Batch(qpos, lying, ways_up(human, lying, library, 1.0, f"{seed}_{first}"))


app = typer.Typer(add_completion=False)


@app.command()
def record(
    corpus: Annotated[Path, typer.Option(help="has get-ups and lying down")],
    out: Annotated[Path, typer.Option(help="folder for what was performed")],
    count: Annotated[int, typer.Option(help="falls")] = 512,
    keep: Annotated[int, typer.Option(help="get-ups of bodies that lie on their backs, faces and sides")] = 8,
    seed: int = 0,
    weights: Annotated[Path, typer.Option(help="policy that falls and gets up")] = WEIGHTS,
) -> None:
    """Record get-ups that the policy performs, the library of the planner `rise`: at most `keep` of a facing.

    Kept are those that went nearest to their way up: followed again, what was done with a delay is done with two.
    """
    human = humanoid(HUMAN)
    settings, policy = policy_of(human, weights)
    out.mkdir(parents=True, exist_ok=True)
    good: dict[str, list[tuple[float, Floats]]] = {}
    for batch in _batches(human, settings, policy, corpus, count, seed):
        did = follow(human, settings, policy, batch.qpos, batch.ways, seed)
        up, facing = stands(human, did), _facing(human, batch.lying_w_m)
        for body in np.flatnonzero(up).tolist():
            motion = did[:, body]
            good.setdefault(str(facing[body]), []).append((off_m(motion, batch.ways[body]), motion))
    kept: dict[str, list[float]] = {}
    for facing_name, found in sorted(good.items()):
        best = sorted(found, key=lambda each: each[0])[:keep]
        kept[facing_name] = [round(off, 4) for off, _ in best]
        for number, (_, motion) in enumerate(best):
            path = out / f"{facing_name}_{number}.npz"
            np.savez_compressed(path, positions_w_m=motion.astype(np.float32), fps=np.float64(TICK_HZ))
    policy_hash = hashlib.sha256(weights.read_bytes()).hexdigest()[:12]
    card = {"weights": policy_hash, "falls": count, "seed": seed, "off_m": kept}
    (out / "card.json").write_text(json.dumps(card, indent=1) + "\n", encoding="utf-8")
    typer.echo(json.dumps(card))


@app.command()
def ways(
    corpus: Annotated[Path, typer.Option(help="has get-ups and lying down")],
    out: Annotated[Path, typer.Option(help="folder for the ways up")],
    count: Annotated[int, typer.Option(help="falls")] = 512,
    seed: int = 0,
    weights: Annotated[Path, typer.Option(help="policy that falls")] = WEIGHTS,
) -> None:
    """Write a bank of ways up from falls, for `train tracker --bank`."""
    human = humanoid(HUMAN)
    loaded = Corpus.load(corpus)
    settings, policy = policy_of(human, weights)
    out.mkdir(parents=True, exist_ok=True)
    library, upright = library_of(loaded, "train"), upright_references(human, loaded)
    made = 0
    for first in range(0, count, BATCH):
        _, lying = fall(human, upright, settings, policy, min(BATCH, count - first), seed + first)
        ups = ways_up(human, lying, library, 1.0, f"{seed}_{first}")
        # What comes first in a name tells clips that fail alike (`sampling.kin_of`).
        for facing, way in zip(_facing(human, lying), ups, strict=True):
            name = f"{facing}_{way.name.replace('/', '_')}"
            np.savez(out / f"{name}.npz", positions_w_m=way.positions_w_m.astype(np.float32), behaviour=GET_UP)
            made += 1
        typer.echo(f"{made} ways up")


if __name__ == "__main__":
    with errors_for_people():
        app()
