"""Executors: what cannot be had is told before the work, rows as Parquet, and a Ray cluster of two nodes."""

from __future__ import annotations

import asyncio
import importlib.util
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from orchestrator.cli.measure import evaluate
from orchestrator.core.services import Services
from orchestrator.evaluation.executor import Pairing
from orchestrator.evaluation.on_ray import RayCluster
from orchestrator.evaluation.parquet import write_parquet
from orchestrator.evaluation.rows import Measured
from shared.errors import InvalidInputError

HALVES = "eval tasks --tasks halt,reach --episodes 3 --planner stand --tracker kinematic --jobs 2"


def row(index: int, **other: Any) -> dict[str, Any]:
    return Measured(seed=2, weights="a").stamped(
        {
            "task": "sit", "index": index, "plans": 4, "octant": None, "limb": None, "strict": True, "paper": True,
            "code": False, "fell": False, "seconds": 2.5, "reason": None, "measures": {"drift_m": 0.5}, **other,
        }
    )  # fmt: skip


def test_rows_come_back_from_parquet_as_they_were_written(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet", reason="rows as Parquet need pyarrow")
    rows = [row(0), row(1, octant=3, limb="left_hand", strict=False, reason="timed out", measures={})]
    write_parquet(tmp_path / "new" / "rows.parquet", rows)
    back = parquet.read_table(tmp_path / "new" / "rows.parquet").to_pylist(maps_as_pydicts="strict")
    assert back == rows


@pytest.mark.parametrize(
    ("options", "missing", "told"),
    [
        (["--executor", "ray"], "ray", "motionloop[ray]"),
        (["--parquet", "rows.parquet"], "pyarrow", "motionloop[parquet]"),
        (["--ray-address", "auto"], "", "--executor ray"),
    ],
)
def test_what_cannot_be_had_is_told_before_the_work(
    options: list[str], missing: str, told: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *rest: None if name == missing else find(name, *rest))
    monkeypatch.chdir(tmp_path)
    refused = CliRunner(env={"COLUMNS": "200"}).invoke(evaluate, ["tasks", "--tasks", "halt", *options])
    assert refused.exit_code == 1, refused.output
    assert told in refused.output


@dataclass(frozen=True)
class Errand:
    """Which job, and the folder where the first to be killed leaves a mark."""

    number: int
    folder: Path


async def killed_once(services: Services, errand: Errand) -> tuple[int, str]:
    """A job whose process is killed the first time that the last errand is done."""
    mark = errand.folder / "killed"
    if errand.number == 5 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return errand.number, services.tracker.plugin_name


@pytest.fixture(scope="module")
def cluster() -> Iterator[str]:
    """Two nodes of one core each on this machine; the address."""
    nodes = pytest.importorskip("ray.cluster_utils", reason="a Ray cluster needs ray")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(Path(__file__).resolve().parents[2]))
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        patch.setenv("RAY_worker_niceness", "0")  # else a busy machine starves them
        own = {"num_cpus": 1, "include_dashboard": False}
        both = nodes.Cluster(initialize_head=True, head_node_args=own)
        try:
            both.add_node(num_cpus=1)
            yield str(both.address)
        finally:
            both.shutdown()


@pytest.mark.slow
@pytest.mark.timeout(1500)
def test_two_nodes_of_ray_give_the_rows_that_local_processes_give(cluster: str, tmp_path: Path) -> None:
    for name, options in (("local", []), ("ray", ["--executor", "ray", "--ray-address", cluster])):
        files = ["--json", str(tmp_path / f"{name}.json"), "--parquet", str(tmp_path / f"{name}.parquet")]
        subprocess.run([sys.executable, "-m", "motionloop", *HALVES.split(), *options, *files], check=True, timeout=600)
    here, there = (json.loads((tmp_path / f"{name}.json").read_text()) for name in ("local", "ray"))
    assert here["tasks"]["halt"]["success_strict"] == 1.0 and here["tasks"]["reach"]["success_strict"] == 0.0
    for same in ("tasks", "weights", "planner", "tracker", "fixed"):
        assert there[same] == here[same]
    assert (tmp_path / "ray.parquet").read_bytes() == (tmp_path / "local.parquet").read_bytes()


@pytest.mark.slow
@pytest.mark.timeout(1500)
def test_jobs_of_a_pair_that_is_lost_are_done_by_the_others(cluster: str, tmp_path: Path) -> None:
    said: list[str] = []
    found: list[tuple[int, str]] = []
    pairing = Pairing(planner="stand", tracker="kinematic")

    async def all_of_them(on: RayCluster) -> None:
        await on.open()
        errands = [Errand(number, tmp_path) for number in range(8)]
        await on.run(killed_once, errands, lambda errand, result: found.append(result))
        await on.close()

    with RayCluster(pairing, pairs=2, parallel=4, address=cluster, say=said.append) as on:
        asyncio.run(all_of_them(on))
    assert sorted(found) == [(number, "kinematic") for number in range(8)]
    assert (tmp_path / "killed").exists() and any("1 left" in line for line in said)


@pytest.mark.slow
@pytest.mark.timeout(1500)
def test_more_pairs_than_cores_are_refused(cluster: str) -> None:
    on = RayCluster(Pairing(), pairs=3, parallel=3, address=cluster)
    with on, pytest.raises(InvalidInputError, match="2 cores") as told:
        asyncio.run(on.open())
    assert told.value.allowed == "1 to 2"
