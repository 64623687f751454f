"""`python -m tracker_service.training.track_corpus`: the corpus as the physics performs it (DESIGN 9).

A planner in the loop continues what the simulation did, not what was recorded. So its training sees both: every clip
that the policy can follow is added a second time as the body performed it.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
import torch
import typer

from shared.console import errors_for_people
from shared.data.corpus import ClipInfo, Corpus, write_corpus
from shared.errors import InvalidInputError
from tracker_service.simulation.character_spec import HUMAN
from tracker_service.simulation.humanoid import Humanoid, humanoid
from tracker_service.training.dataset import ReferenceSet
from tracker_service.training.env import TrackingEnv
from tracker_service.training.env_settings import EnvSettings
from tracker_service.training.main import references
from tracker_service.training.network import ActorCritic, Normalizer
from tracker_service.training.ppo import to_numpy

F32 = npt.NDArray[np.float32]
Policy = Callable[[F32], F32]

LOST_M = 0.35
"""A joint farther from the reference than this is no longer a performance of the clip."""
BEFORE_LOSS_TICKS = 20
LEAST_TICKS = 75


def perform(human: Humanoid, clips: ReferenceSet, rows: npt.NDArray[np.int64], policy: Policy) -> list[F32]:
    """What the body did following each of the clips `rows` from its start: (T, 22, 3), until it was lost or ended.

    Stretches too short to be of use are empty.
    """
    env = TrackingEnv(human, clips, EnvSettings(envs=len(rows)), seed=0)
    ticks = clips.length[rows] - 1
    observation = env.start_at(rows)
    did = [env.bodies().pos_w_m.astype(np.float32)]
    held = np.zeros(len(rows), dtype=np.int64)
    alive = np.ones(len(rows), dtype=bool)
    for tick in range(int(ticks.max())):
        distance, _, exploded = env.advance(policy(observation))
        alive &= (tick < ticks) & (distance.max(axis=-1) < LOST_M) & ~exploded
        if not alive.any():
            break
        held[alive] = tick + 1
        did.append(env.bodies().pos_w_m.astype(np.float32))
        observation = env.observe()
    env.close()
    whole = np.stack(did)
    count = np.where(held >= ticks, held, held - BEFORE_LOSS_TICKS) + 1
    return [whole[: n if n >= LEAST_TICKS else 0, i] for i, n in enumerate(count)]


def load_policy(checkpoint: Path, human: Humanoid) -> Policy:
    """The averaged policy of a training checkpoint, without exploration."""
    state = torch.load(checkpoint, weights_only=True)
    size = int(state["normalizer"]["mean"].shape[0])
    actor, normalizer = ActorCritic(size, len(human.hinges)).actor, Normalizer(size)
    actor.load_state_dict(state["averaged"])
    normalizer.load_state_dict(state["normalizer"])

    @torch.no_grad()
    def act(observation: F32) -> F32:
        return to_numpy(actor(normalizer(torch.from_numpy(observation))))

    return act


def with_performances(
    corpus: Corpus, clips: ReferenceSet, human: Humanoid, policy: Policy, share: float, batch: int = 256,
    only_recorded: Collection[str] = (), say: Callable[[str], None] = print,
) -> list[tuple[ClipInfo, npt.NDArray[np.floating]]]:  # fmt: skip
    """All clips of the corpus, and those that the policy could follow as it performed them.

    Args:
        clips: prepared references of the training split.
        share: of each behaviour's samples for performed clips.
        only_recorded: behaviours of which no performance is kept.
    """
    number = {clip.name: i for i, clip in enumerate(corpus.clips)}
    order = np.argsort(clips.length)
    performed: list[tuple[ClipInfo, npt.NDArray[np.floating]]] = []
    for first in range(0, len(order), batch):
        rows = order[first : first + batch]
        for row, motion in zip(rows, perform(human, clips, rows, policy), strict=True):
            info = corpus.clips[number[str(clips.names[row])]]
            if len(motion) and info.behaviour not in only_recorded:
                performed.append((replace(info, name=f"{info.name}~performed", made=True), motion))
        say(f"{min(first + batch, len(order))} of {len(order)} clips, {len(performed)} kept")
    if not performed:
        raise InvalidInputError("the policy can follow no clip", field="checkpoint")
    recorded = [(info, corpus.positions(i)) for i, info in enumerate(corpus.clips)]
    weights = shared_weights([info for info, _ in recorded], [info for info, _ in performed], share)
    both = [*recorded, *performed]
    return [(replace(info, weight=weight), motion) for (info, motion), weight in zip(both, weights, strict=True)]


def shared_weights(recorded: Sequence[ClipInfo], performed: Sequence[ClipInfo], share: float) -> list[float]:
    """Weights of recorded, then performed clips: of each behaviour's old total, performed clips get `share`."""
    old: dict[str, float] = defaultdict(float)
    found: dict[str, float] = defaultdict(float)
    for info in recorded:
        old[info.behaviour] += info.weight
    for info in performed:
        found[info.behaviour] += info.weight
    return [info.weight * (1.0 - share if found[info.behaviour] else 1.0) for info in recorded] + [
        info.weight / found[info.behaviour] * old[info.behaviour] * share for info in performed
    ]


def main(
    corpus: Annotated[Path, typer.Option(help="folder made by `motionloop data build`")],
    checkpoint: Annotated[Path, typer.Option(help="of the tracker's training")],
    out: Annotated[Path, typer.Option(help="folder of the new corpus")],
    cache: Annotated[Path, typer.Option(help="folder of prepared references")],
    share: Annotated[float, typer.Option(min=0.01, max=0.99, help="of the samples for performed clips")] = 0.6,
    only_recorded: Annotated[str, typer.Option(help="behaviours whose finer points physics flattens")] = "wave",
) -> None:
    """Add to a corpus its clips as the physics performs them."""
    torch.set_num_threads(1)
    human = humanoid(HUMAN)
    whole = Corpus.load(corpus)
    clips = references(corpus, "train", cache, typer.echo)
    policy = load_policy(checkpoint, human)
    result = with_performances(
        whole, clips, human, policy, share, only_recorded=only_recorded.split(","), say=typer.echo
    )
    added = result[len(whole) :]
    facts: dict[str, Any] = {
        "clips": len(added),
        "minutes": round(sum(len(m) for _, m in added) / 1800, 1),
        "share": share,
        "checkpoint_samples": int(torch.load(checkpoint, weights_only=True)["counters"][0]),
    }
    write_corpus(out, result, {**whole.manifest, "performed": facts})
    typer.echo(str(facts))


if __name__ == "__main__":
    with errors_for_people():
        typer.run(main)
