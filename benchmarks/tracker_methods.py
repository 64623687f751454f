"""The tracker learns from nothing, once through the world model and once by PPO: success against time and samples.

    python benchmarks/tracker_methods.py --corpus CORPUS --out OUT [--seeds 3] [--minutes 10] [--judge-every 2.5]

Both learn on the same clips, with as many environments and threads, on the machine it runs on; time is that of
learning, with what the world model needs before its first update, without that of judging. A run that was cut off
is done again, finished ones are kept in OUT/rows.jsonl; the table goes to OUT/table.md.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch

from tracker_service.simulation.character_spec import HUMAN
from tracker_service.simulation.humanoid import humanoid
from tracker_service.training.dataset import ReferenceSet
from tracker_service.training.env_settings import EnvSettings
from tracker_service.training.main import training_sets
from tracker_service.training.ppo import PpoSettings
from tracker_service.training.trainer import Trainer
from tracker_service.training.world.settings import WorldSettings
from tracker_service.training.world.trainer import WorldTrainer

Row = dict[str, Any]
METHODS = ("world", "ppo")
MEASURED = ("success", "mpjpe_mm", "falls_per_min")


class Learning(Protocol):
    """What both trainers have."""

    samples: int

    def iterate(self) -> dict[str, float]: ...

    def judge(self) -> dict[str, Any]: ...


def learner_of(
    method: str, sets: tuple[ReferenceSet, ReferenceSet], out: Path, env: EnvSettings, seed: int
) -> Learning:
    """A trainer that has learnt nothing yet."""
    human = humanoid(HUMAN)
    if method == "ppo":
        return Trainer(human, *sets, out, env, PpoSettings(), seed)
    return WorldTrainer(human, *sets, out, env, WorldSettings(), seed)


def learn(learning: Learning, marks_s: Iterable[float], clock: Callable[[], float] = time.monotonic) -> list[Row]:
    """Learn, and judge whenever so many seconds of learning are over: `seconds`, `samples` and MEASURED of each."""
    rows = []
    spent = 0.0
    begun = clock()
    if isinstance(learning, WorldTrainer):
        learning.prepare(lambda line: None, fresh_sight=True, fresh_model=True)
    for mark in marks_s:
        while (now := spent + clock() - begun) < mark:
            learning.iterate()
        judged = learning.judge()
        rows.append({"seconds": round(now, 1), "samples": learning.samples, **{k: judged[k] for k in MEASURED}})
        spent, begun = now, clock()
    return rows


def table(rows: Sequence[Row], marks_s: Sequence[float]) -> str:
    """Markdown: for each method and mark the mean over the seeds, with the least and the most."""
    lines = [
        "| learnt by | minutes | seeds | samples | success | mpjpe_mm | falls a minute |",
        "|---|---|---|---|---|---|---|",
    ]
    for method in METHODS:
        for number, mark in enumerate(marks_s):
            at = [row for row in rows if row["method"] == method and row["mark"] == number]
            if at:
                samples = np.mean([row["samples"] for row in at]) / 1e6
                cells = [
                    _spread([row[name] for row in at], digits) for name, digits in zip(MEASURED, (3, 0, 1), strict=True)
                ]
                lines.append(f"| {method} | {mark / 60:g} | {len(at)} | {samples:.2f} M | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _spread(values: Sequence[float], digits: int) -> str:
    return f"{np.mean(values):.{digits}f} ({min(values):.{digits}f}-{max(values):.{digits}f})"


def finished(path: Path, marks_s: Sequence[float]) -> list[Row]:
    """Rows of the runs in a file that came to the last of these marks (seconds)."""
    rows: list[Row] = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    last = (len(marks_s) - 1, marks_s[-1])
    done = {(row["method"], row["seed"]) for row in rows if (row["mark"], row["mark_s"]) == last}
    return [row for row in rows if (row["method"], row["seed"]) in done]


def main(argv: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser("benchmarks/tracker_methods.py", description=__doc__)
    parser.add_argument("--corpus", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--judge-every", type=float, default=2.5, help="minutes of learning")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--envs", type=int, default=320)
    options = parser.parse_args(argv)
    torch.set_num_threads(options.threads)
    marks = [60.0 * m for m in np.arange(1, round(options.minutes / options.judge_every) + 1) * options.judge_every]
    sets = training_sets(humanoid(HUMAN), options.corpus, options.out / "cache", {}, {}, print, options.threads)
    path = options.out / "rows.jsonl"
    rows = finished(path, marks)
    for seed in range(options.seeds):
        for method in METHODS:
            if any(row["method"] == method and row["seed"] == seed for row in rows):
                continue
            # Neither sees heights: PPO's environments have no seats in what they show.
            env = EnvSettings(envs=options.envs, threads=options.threads)
            learning = learner_of(method, sets, options.out / f"{method}_{seed}", env, seed)
            for mark, row in enumerate(learn(learning, marks)):
                rows.append({"method": method, "seed": seed, "mark": mark, "mark_s": marks[mark], **row})
            path.write_text("".join(json.dumps(row) + "\n" for row in rows), encoding="utf-8")
            print(json.dumps(rows[-1]), flush=True)
    machine = f"{platform.machine()}, {os.cpu_count()} cores, {options.threads} threads, {options.envs} environments"
    text = f"{machine}; {len(sets[0])} clips to train on, {len(sets[1])} held out\n\n{table(rows, marks)}"
    (options.out / "table.md").write_text(text, encoding="utf-8")
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
