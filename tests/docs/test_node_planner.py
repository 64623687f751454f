"""A planner in another language, from the protocol's page alone, passes the suite and drives a character."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from orchestrator.client import Client
from orchestrator.core.supervise import ServiceProcess, Stack
from shared.plugins.conformance import check_planner_endpoint
from tests.docs.conftest import REPO
from tests.orchestrator.support import light, running

EXAMPLE = REPO / "examples" / "node_planner"


@pytest.fixture(scope="module")
def node_planner(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServiceProcess]:
    """The example as a process; skipped where Node or its ZeroMQ package cannot be had."""
    node, npm = shutil.which("node"), shutil.which("npm")
    if node is None or npm is None:
        pytest.skip("needs Node and npm")
    folder = tmp_path_factory.mktemp("node")
    for file in EXAMPLE.iterdir():
        if file.is_file():
            shutil.copy(file, folder)
    install = [npm, "install", "--no-audit", "--no-fund"]
    done = subprocess.run(install, cwd=folder, capture_output=True, text=True, check=False)
    loads = [node, "--input-type=module", "-e", "import 'zeromq'"]
    if done.returncode or subprocess.run(loads, cwd=folder, capture_output=True, check=False).returncode:
        pytest.skip(f"the package zeromq cannot be installed: {done.stderr[-300:]}")
    with running("node planner", node, str(folder / "planner.mjs"), "tcp://127.0.0.1:*") as process:
        yield process


def test_it_passes_the_suite(node_planner: ServiceProcess) -> None:
    results = check_planner_endpoint(node_planner.address)
    assert [result for result in results if not result.passed] == []
    assert len(results) >= 9


def test_it_is_swapped_in_while_a_character_runs_and_takes_it_to_a_target(
    node_planner: ServiceProcess, tmp_path: Path
) -> None:
    with Stack(light(tmp_path)) as stack, Client(stack.url) as client, client.character(pacing="lockstep") as character:
        character.step(30)
        assert client.swap("planner", endpoint=node_planner.address).plugin == "slide"
        character.say(target=(1.5, -0.5))
        there = character.step(150)
        assert np.linalg.norm(there.pelvis_w_m[:2] - [1.5, -0.5]) < 0.1
        assert client.swap("planner", endpoint=stack.planner.address).plugin == "stand"
        assert character.step(30).tick == 210
