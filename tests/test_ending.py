"""A process that is told to end does so, whatever it is at: starting in a library's call, or hanging as it finishes."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

REPO = Path(__file__).resolve().parent.parent
HANG = "while True: ctypes.CDLL(None).sleep(600)"
"""In a call of a library, again and again: where no Python of ours runs."""
GIVE_UP_S = 120.0

STARTING = f"""
import ctypes
from shared.ending import Ending
ending = Ending()
def make():
    print("now", flush=True)
    {HANG}
ending.start(make)
"""
FINISHING = f"""
import ctypes
from shared.ending import Ending
ending = Ending(grace_s=0.2)
given = ending.start(lambda: "now")
ending.serve()
print(given, flush=True)
ending.wait()
{HANG}
"""
SERVING = """
from shared.ending import Ending
ending = Ending()
ending.serve()
print("now", flush=True)
ending.wait()
print("done")
ending.leave(3)
"""


def ended(code: str, number: signal.Signals) -> tuple[int, str]:
    """Exit code and further output of a process that got the signal when it said `now`."""
    with subprocess.Popen([sys.executable, "-c", code], cwd=REPO, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "now\n"
            process.send_signal(number)
            out, _ = process.communicate(timeout=GIVE_UP_S)
            return process.returncode, out
        finally:
            process.kill()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize(
    ("code", "wanted"), [(STARTING, (0, "")), (FINISHING, (0, "")), (SERVING, (3, "done\n"))],
    ids=["starting", "finishing", "serving"],
)  # fmt: skip
def test_a_signal_ends_it(code: str, wanted: tuple[int, str], number: signal.Signals) -> None:
    assert ended(code, number) == wanted


def test_what_goes_wrong_at_the_start_is_raised_where_it_is_waited_for() -> None:
    code = """
from shared.ending import Ending
try:
    Ending().start(lambda: 1 / 0)
except ZeroDivisionError:
    print("raised")
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=REPO, capture_output=True, text=True, timeout=GIVE_UP_S)
    assert (done.returncode, done.stdout) == (0, "raised\n"), done.stderr
