"""Fixtures that every test may use: the mocap folder, free endpoints, one thread a process, no process left behind."""

from __future__ import annotations

import os
import signal
import socket
import time
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path

for _name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
# Settings of whoever runs the tests are not those of the services in them.
FOR_TESTS = ("MOTIONLOOP_MOCAP", "MOTIONLOOP_FUZZ", "MOTIONLOOP_CHROMIUM")
for _name in [name for name in os.environ if name.startswith("MOTIONLOOP_") and name not in FOR_TESTS]:
    del os.environ[_name]
# A shell's background job ignores Ctrl-C, and so would every process that a test starts and interrupts.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
# Every process that a test starts inherits this mark, so that even an orphan is found at the end.
os.environ["MOTIONLOOP_TEST_MARK"] = uuid.uuid4().hex

import psutil
import pytest
from hypothesis import HealthCheck, settings

REPO = Path(__file__).resolve().parent.parent

settings.register_profile(
    "motionloop", deadline=None, max_examples=50, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("motionloop")


@pytest.fixture(scope="session")
def mocap_dir() -> Path:
    """Folder of recorded motion: MOTIONLOOP_MOCAP, else `shared/mocap` beside the checkout.

    Where it is absent the test is skipped and says so; in CI its absence is a failure.
    """
    folder = Path(os.environ.get("MOTIONLOOP_MOCAP", REPO.parent / "shared" / "mocap"))
    if not folder.is_dir():
        reason = f"no recorded motion at {folder}: set MOTIONLOOP_MOCAP"
        if os.environ.get("CI") == "true":
            pytest.fail(reason)
        pytest.skip(reason)
    return folder


@pytest.fixture
def free_port() -> Callable[[], int]:
    """A function that gives a TCP port on 127.0.0.1 that nobody listens on."""

    def pick() -> int:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            return int(probe.getsockname()[1])

    return pick


@pytest.fixture
def free_endpoint(free_port: Callable[[], int]) -> Callable[[], str]:
    """A function that gives a ZeroMQ endpoint on 127.0.0.1 that nobody listens on."""
    return lambda: f"tcp://127.0.0.1:{free_port()}"


def _left_behind() -> list[psutil.Process]:
    mark = os.environ["MOTIONLOOP_TEST_MARK"]
    found = []
    for process in psutil.process_iter():
        try:
            if process.pid != os.getpid() and process.environ().get("MOTIONLOOP_TEST_MARK") == mark:
                command = " ".join(process.cmdline())
                if process.status() != psutil.STATUS_ZOMBIE and "multiprocessing.resource_tracker" not in command:
                    found.append(process)
        except (psutil.NoSuchProcess, psutil.AccessDenied):
            continue
    return found


@pytest.fixture(scope="session", autouse=True)
def no_process_left_behind() -> Iterator[None]:
    """Fail the session when a test leaves a process running; what is left is ended by its id."""
    yield
    give_up = time.monotonic() + 5.0
    while (left := _left_behind()) and time.monotonic() < give_up:
        time.sleep(0.1)
    names = []
    for process in left:
        try:
            names.append(f"{process.pid}: {' '.join(process.cmdline())}")
            process.kill()
        except psutil.NoSuchProcess:
            continue
    assert not names, "processes left running by tests:\n" + "\n".join(names)
