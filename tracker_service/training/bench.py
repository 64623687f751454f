"""`python -m tracker_service.training.bench`: CPU time of a control tick and of training's ticks."""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np

from shared.motion.ik import standing_clip
from shared.protocol.rates import TICK_HZ
from shared.scenes.files import load_scene
from tracker_service.policy.registry import make_tracker
from tracker_service.simulation.character import SUBSTEPS, SimulatedCharacter
from tracker_service.simulation.character_spec import character as character_spec
from tracker_service.simulation.humanoid import humanoid, humanoid_model
from tracker_service.simulation.scene import build_scene
from tracker_service.training.dataset import MotionInput, prepare
from tracker_service.training.env import TrackingEnv
from tracker_service.training.env_settings import EnvSettings

HUMANOID = humanoid(character_spec("human"))
ROUNDS = 5


def _microseconds(action: Callable[[], object], times: int) -> float:
    """Median over rounds of the CPU microseconds of this thread that a call takes."""
    rounds = []
    for _ in range(ROUNDS):
        began = time.thread_time()
        for _ in range(times):
            action()
        rounds.append((time.thread_time() - began) / times * 1e6)
    return statistics.median(rounds)


def bench_tracker(tracker: str = "learned", ticks: int = 60, envs: int = 64, seed: int = 0) -> dict[str, float | str]:
    """Cost of one character that stands and follows its reference.

    Returns:
        tick_us: a control tick with policy, physics and samples; mj_step_us: one bare physics substep in the same
        state; ratio: tick over its four substeps; train_samples_per_s: ticks a second that training's environments
        make on one thread, without the learner. All in CPU time.
    """
    scene = build_scene(HUMANOID, load_scene("flat"))
    character = SimulatedCharacter(scene, make_tracker(tracker, HUMANOID))
    character.step(30)
    tick_us = _microseconds(lambda: character.step(1), ticks)

    model = humanoid_model(HUMANOID)
    data = mujoco.MjData(model)
    count = 7 + len(HUMANOID.hinges)
    data.qpos[:count] = character.reference.at(character.tick).qpos[0]
    data.ctrl[:] = data.qpos[7:count]
    for _ in range(30):
        mujoco.mj_step(model, data)
    begun = data.qpos.copy()

    def substeps() -> None:
        data.qpos[:], data.qvel[:] = begun, 0.0
        for _ in range(SUBSTEPS):
            mujoco.mj_step(model, data)

    mj_step_us = _microseconds(substeps, ticks) / SUBSTEPS
    return {
        "tracker": tracker,
        "tick_us": round(tick_us, 1),
        "mj_step_us": round(mj_step_us, 1),
        "ratio": round(tick_us / (SUBSTEPS * mj_step_us), 2),
        "train_samples_per_s": round(_training_rate(envs, seed), 1),
    }


def _training_rate(envs: int, seed: int) -> float:
    standing = standing_clip(4 * TICK_HZ, TICK_HZ).positions_w_m
    references = prepare(HUMANOID, [MotionInput("stand", "stand", 1.0, standing)])
    env = TrackingEnv(HUMANOID, references, EnvSettings(envs=envs), seed)
    try:
        env.reset_all()
        rest = np.zeros((envs, env.hinges), dtype=np.float32)
        return envs * 1e6 / _microseconds(lambda: env.step(rest), 10)
    finally:
        env.close()


def main(argv: list[str] | None = None) -> int:
    """Command line; the result as JSON on standard output and in `--json FILE`."""
    parser = argparse.ArgumentParser("tracker_service.training.bench", description=__doc__)
    parser.add_argument("--tracker", default="learned")
    parser.add_argument("--ticks", type=int, default=60, help="ticks a round")
    parser.add_argument("--envs", type=int, default=64)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args(argv)
    text = json.dumps(bench_tracker(options.tracker, options.ticks, options.envs, options.seed), indent=2)
    if options.json is not None:
        options.json.write_text(text + "\n")
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
