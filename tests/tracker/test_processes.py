"""Environments in processes end with the training that made them, however it ends."""

from __future__ import annotations

import subprocess
import sys
import time

import psutil
import pytest

SCRIPT = """
import multiprocessing, os, signal, sys
from shared.motion.ik import standing_clip
from tracker_service.simulation.character_spec import HUMAN
from tracker_service.simulation.humanoid import humanoid
from tracker_service.training.dataset import MotionInput, prepare
from tracker_service.training.env_settings import EnvSettings
from tracker_service.training.processes import ProcessEnv

human = humanoid(HUMAN)
standing = prepare(human, [MotionInput("a", "stand", 1.0, standing_clip(60, 30.0).positions_w_m)])
env = ProcessEnv(human, standing, EnvSettings(envs=4, processes=3), 0)
env.reset_all()
print(*(child.pid for child in multiprocessing.active_children()), flush=True)
"""
WAIT_S = 60.0


@pytest.mark.parametrize(
    ("end", "code"), [("raise RuntimeError('disk full')", 1), ("os.kill(os.getpid(), signal.SIGKILL)", -9)]
)
def test_children_end_with_their_parent(end: str, code: int) -> None:
    done = subprocess.Popen([sys.executable, "-c", SCRIPT + end], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    assert done.stdout is not None
    children = [int(pid) for pid in done.stdout.readline().split()]
    try:
        assert len(children) == 3
        assert done.wait(WAIT_S) == code
        until = time.monotonic() + WAIT_S
        while left := [pid for pid in children if psutil.pid_exists(pid)]:
            assert time.monotonic() < until, f"{left} live on"
            time.sleep(0.05)
    finally:
        done.kill()
        for pid in children:
            if psutil.pid_exists(pid):
                psutil.Process(pid).kill()
        done.wait()
        done.stdout.close()
