"""Ten thousand characters on a cluster that is not there: what it takes, and where it breaks.

    python benchmarks/cluster_simulation.py --characters 10000 --json out/cluster.json

A discrete simulation of the services with what they were measured to cost (docs/cluster.md). Characters are in shards
of an orchestrator each; a planner of one core plans for some of them (batches of up to eight, first come first served),
and trackers of one core each host some. Each character asks for a plan once a period, from a phase of its own; users'
commands arrive at random and ask at once. A plan is late when it takes longer than it was asked for ahead. A tracker
does the ticks of its characters one after the other, thirty times a second; one that is done more than a tick late is
missed. No process is planned to be busier than four fifths of the time.
"""

from __future__ import annotations

import argparse
import heapq
import sys
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from orchestrator.cli.common import provenance, write_json

TICK_S = 1 / 30
BUSIEST = 0.8
PARTS = ("orchestrators", "planners", "trackers")
SIZES = ("shard", "planned", "host")


@dataclass(frozen=True)
class Costs:
    """CPU times as measured; where from is in docs/cluster.md.

    Attributes:
        batch_s, plan_s: a batch of n plans takes batch_s + n plan_s.
        tick_s: of one character. orchestrator: cores that one character keeps busy there.
        command_s: of the orchestrator, for one command over HTTP.
        spread: standard deviation of the logarithm of every time.
    """

    batch_s: float = 0.040
    plan_s: float = 0.052
    tick_s: float = 0.0016
    orchestrator: float = 0.19
    command_s: float = 0.006
    spread: float = 0.25


@dataclass(frozen=True)
class Cluster:
    """What is there for the characters.

    Attributes:
        shard, planned, host: characters an orchestrator, a planner and a tracker, each of one core.
        period_s, lead_s: between the plans of a character; how long ahead one is asked for.
        commands_per_s: of each character's user.
        batch: most plans at once.
    """

    shard: int
    planned: int
    host: int
    period_s: float = 1.0
    lead_s: float = 0.4
    commands_per_s: float = 0.1
    batch: int = 8


def planner(cluster: Cluster, costs: Costs, seconds: float, rng: np.random.Generator) -> dict[str, float]:
    """One planner and its characters' requests: share late, busy share, median and 95th percentile of the waits."""
    asked: list[float] = []
    for phase in rng.uniform(0.0, cluster.period_s, cluster.planned):
        asked += list(np.arange(phase, seconds, cluster.period_s))
    commands = rng.poisson(cluster.commands_per_s * cluster.planned * seconds)
    asked += list(rng.uniform(0.0, seconds, commands))
    heapq.heapify(asked)
    free_s, busy_s, waits = 0.0, 0.0, []
    while asked:
        begin_s = max(free_s, asked[0])
        batch = []
        while asked and asked[0] <= begin_s and len(batch) < cluster.batch:
            batch.append(heapq.heappop(asked))
        takes_s = (costs.batch_s + costs.plan_s * len(batch)) * rng.lognormal(0.0, costs.spread)
        free_s, busy_s = begin_s + takes_s, busy_s + takes_s
        waits += [free_s - each for each in batch]
    there = np.array(waits)
    return {
        "late": float((there > cluster.lead_s).mean()),
        "busy": busy_s / max(seconds, free_s),
        "p50_ms": float(np.percentile(there, 50)) * 1e3,
        "p95_ms": float(np.percentile(there, 95)) * 1e3,
    }


def tracker(cluster: Cluster, costs: Costs, seconds: float, rng: np.random.Generator) -> dict[str, float]:
    """One tracker: share of ticks missed, busy share."""
    behind_s, missed, total, busy_s = 0.0, 0, 0, 0.0
    for _ in range(round(seconds / TICK_S)):
        times = costs.tick_s * rng.lognormal(0.0, costs.spread, cluster.host)
        ends = behind_s + np.cumsum(times)
        missed += int((ends > 2 * TICK_S).sum())
        total += cluster.host
        busy_s += float(times.sum())
        behind_s = max(float(ends[-1]) - TICK_S, 0.0)
    return {"missed": missed / total, "busy": busy_s / seconds}


def orchestrator(cluster: Cluster, costs: Costs) -> float:
    """Cores that a shard's orchestrator, one process, would keep busy."""
    return cluster.shard * (costs.orchestrator + cluster.commands_per_s * costs.command_s)


def fits(cluster: Cluster, costs: Costs, seconds: float, seed: int) -> bool:
    """Under one plan in a hundred late, under half a per cent of ticks missed, and no process too busy."""
    plans = planner(cluster, costs, seconds, np.random.default_rng(seed))
    ticks = tracker(cluster, costs, seconds, np.random.default_rng(seed))
    busiest = max(plans["busy"], ticks["busy"], orchestrator(cluster, costs))
    return plans["late"] < 0.01 and ticks["missed"] < 0.005 and busiest <= BUSIEST


def largest(cluster: Cluster, costs: Costs, seconds: float, seed: int) -> Cluster:
    """The most characters that each can have, one after the other."""
    for name in SIZES:
        small = replace(cluster, shard=1, planned=1, host=1)
        size = 1
        while size < 400 and fits(replace(small, **{name: size + 1}), costs, seconds, seed):
            size += 1
        cluster = replace(cluster, **{name: size})
    return cluster


def simulate(characters: int, costs: Costs, cluster: Cluster, seconds: float, seed: int) -> dict[str, Any]:
    """What so many characters take, with the largest shards and trackers that keep time, and what breaks beyond."""
    best = largest(cluster, costs, seconds, seed)
    takes = {name: -(-characters // getattr(best, size)) for name, size in zip(PARTS, SIZES, strict=True)}
    beyond = replace(best, **{name: round(1.5 * getattr(best, name)) for name in SIZES})
    return {
        "characters": characters,
        "costs": asdict(costs),
        "cluster": asdict(best),
        "takes": {**takes, "cores": sum(takes.values())},
        "at_that_size": _loads(best, costs, seconds, seed),
        "half_as_many_more": _loads(beyond, costs, seconds, seed),
    }


def _loads(cluster: Cluster, costs: Costs, seconds: float, seed: int) -> dict[str, Any]:
    found = {
        "planner": planner(cluster, costs, seconds, np.random.default_rng(seed)),
        "tracker": tracker(cluster, costs, seconds, np.random.default_rng(seed)),
        "orchestrator": {"busy": orchestrator(cluster, costs)},
    }
    return {part: {name: round(value, 4) for name, value in numbers.items()} for part, numbers in found.items()}


def main() -> int:
    """Command line; every cost and size can be set."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--characters", type=int, default=10_000)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path)
    given = (Costs(), Cluster(shard=1, planned=1, host=1))
    for settings in given:
        for name, value in asdict(settings).items():
            if name not in SIZES:
                parser.add_argument(f"--{name.replace('_', '-')}", type=type(value), default=value)
    told = vars(parser.parse_args())
    costs, cluster = (
        replace(each, **{name: told[name] for name in asdict(each) if name in told}) for each in given
    )  # fmt: skip
    result = simulate(told["characters"], costs, cluster, told["seconds"], told["seed"])
    write_json(told["json"], {**result, **provenance(told["seed"])})
    return 0


if __name__ == "__main__":
    sys.exit(main())
