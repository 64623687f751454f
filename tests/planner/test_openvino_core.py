"""OpenVINO: no word to anyone, and no dead signal stack."""

from __future__ import annotations

import subprocess
import sys

import pytest

PRELUDE = """
import gc, os, signal, sys
from planner_service.dip.config import preset
from planner_service.dip.network import DipNetwork
from planner_service.dip.openvino_blocks import OpenVinoBlocks
network = DipNetwork(preset("tiny")).eval()
"""
SIGNALS = """
first, second = OpenVinoBlocks(network, True), OpenVinoBlocks(network, True)
del first
gc.collect()
third = OpenVinoBlocks(network)
del second, third
gc.collect()
heard = []
signal.signal(signal.SIGUSR1, lambda number, frame: heard.append(number))
os.kill(os.getpid(), signal.SIGUSR1)
print(len(heard))
"""
SILENCE = """
blocks = OpenVinoBlocks(network)
print([name for name, module in sys.modules.items() if name.startswith("openvino_telemetry") and module is not None])
"""


def printed(code: str) -> str:
    pytest.importorskip("planner_service.dip.openvino_core", reason="the extra `fast` is not installed")
    done = subprocess.run([sys.executable, "-c", PRELUDE + code], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, (done.returncode, done.stderr[-2000:])
    return done.stdout


def test_a_signal_after_blocks_are_gone_in_any_order_is_heard() -> None:
    assert printed(SIGNALS) == "1\n"


def test_nothing_is_sent_to_anyone() -> None:
    assert printed(SILENCE) == "[]\n"
