"""The service as a process: ready line, the same log bit for bit as in this process, a clean end."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from shared.protocol.control import Ok
from shared.protocol.messages import CreateCharacter, Impulse, StateFrame, TickRange, TrackReply
from shared.protocol.transport import ServiceClient
from tests.tracker_service.support import same, standing_plan, step, ticks, track
from tracker_service.service.service import TrackerService

ROOT = Path(__file__).resolve().parents[2]


def start(*arguments: str) -> subprocess.Popen[str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.Popen(
        [sys.executable, "-m", "tracker_service", *arguments],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT, env=environment,
    )  # fmt: skip


@pytest.fixture
def process() -> Iterator[tuple[subprocess.Popen[str], str]]:
    """The process and its endpoint."""
    child = start("--endpoint", "tcp://127.0.0.1:0", "--log-level", "warning")
    try:
        assert child.stdout is not None
        ready = re.match(r"tracker_service ready endpoint=(\S+) state=(\S+)", child.stdout.readline())
        assert ready is not None
        yield child, ready[1]
    finally:
        child.kill()
        child.communicate()


def episode(client: ServiceClient) -> TickRange:
    """Plans and pushes in lockstep; the whole log."""
    client.ask(CreateCharacter(tracker="pd", seed=7), StateFrame, "twin", timeout_s=30.0)
    for start_tick in (0, 15, 30):
        client.ask(track(start_tick, standing_plan(40, sway_rad=0.1 + start_tick / 100)), TrackReply, "twin")
        client.ask(Impulse(body="spine2", impulse_w_ns=(4.0, -2.0, 0.0)), Ok, "twin")
        step(client, "twin", 15)
    return ticks(client, "twin", 0, 46)


def test_the_log_does_not_depend_on_the_process(
    process: tuple[subprocess.Popen[str], str], service: TrackerService
) -> None:
    child, endpoint = process
    with ServiceClient(endpoint, "tracker") as there, ServiceClient(service.endpoint, "tracker") as here:
        assert same(episode(there), episode(here))
    child.send_signal(signal.SIGTERM)
    out, err = child.communicate(timeout=20)
    assert (child.returncode, out) == (0, "tracker_service ended\n"), err


def test_settings_that_cannot_be_used_end_it() -> None:
    for arguments, named in (
        (("--endpoint", "tcp://0.0.0.0:0"), "endpoint"),
        (("--max-characters", "0"), "max_characters"),
    ):
        child = start(*arguments)
        _, err = child.communicate(timeout=30)
        assert child.returncode == 2
        assert named in err
        assert "Traceback" not in err
