"""`python -m tests.chaos.swaps`: planner and tracker are exchanged again and again under running characters."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from orchestrator.client import Client
from orchestrator.client.calls import ServiceKind
from orchestrator.client.sync import Character
from orchestrator.core.supervise import ServiceProcess, Stack
from shared.protocol.control import Health, HealthReport
from shared.protocol.transport import ServiceClient
from tests.orchestrator.support import light

FREE = "tcp://127.0.0.1:0"
CHARACTERS = 4
PLUGINS: dict[ServiceKind, str] = {"planner": "stand", "tracker": "kinematic"}
TURNS: tuple[tuple[int, ServiceKind], ...] = ((1, "planner"), (1, "tracker"), (0, "planner"), (0, "tracker"))
GIVE_UP_S = 120.0


def until(condition: Callable[[], bool], what: str) -> None:
    """Wait for it; raises AssertionError when it never comes."""
    give_up_s = time.monotonic() + GIVE_UP_S
    while not condition():
        assert time.monotonic() < give_up_s, f"never: {what}"
        time.sleep(0.05)


def swaps(folder: Path, every_s: float, seconds: float) -> dict[str, Any]:
    """Exchange planner, then tracker, each for a second process and back, while four characters run by the clock.

    After each the characters must have moved on, and planned with what was put in.

    Returns:
        `swaps`, what each took (`swap_ms`), ticks that the characters ran and missed, and the largest step of a joint
        between two ticks (`step_m`), which a character that lost its state would show.
    """
    second_planner = [sys.executable, "-m", "planner_service", "--endpoint", FREE, "--plugins", "stand"]
    second_tracker = [sys.executable, "-m", "tracker_service", "--endpoint", FREE]
    others = {
        "planner": ServiceProcess("second planner", second_planner),
        "tracker": ServiceProcess("second tracker", second_tracker),
    }
    took_ms: list[float] = []
    try:
        for process in others.values():
            process.start()
        for process in others.values():
            process.wait_ready()
        with Stack(light(folder)) as stack, Client(stack.url) as client:
            places: dict[ServiceKind, tuple[str, str]] = {
                "planner": (stack.planner.address, others["planner"].address),
                "tracker": (stack.tracker.address, others["tracker"].address),
            }
            characters = [client.character() for _ in range(CHARACTERS)]
            began_s = time.monotonic()
            while not took_ms or time.monotonic() - began_s < seconds:
                for turn, kind in TURNS:
                    took_ms.append(_swap(client, characters, kind, places[kind][turn]))
                    time.sleep(every_s)
            motions = [character.motion(seconds=10.0) for character in characters]
            told = [character.info() for character in characters]
            missed = client.health().tracker.detail.get("missed_ticks", 0)
            for character in characters:
                character.close()
    finally:
        for process in others.values():
            process.stop()
    steps = [float(np.linalg.norm(np.diff(m.positions_w_m, axis=0), axis=-1).max()) for m in motions]
    return {
        "swaps": len(took_ms),
        "swap_ms": {"p50": round(float(np.median(took_ms))), "most": round(max(took_ms))},
        "status": [each.status for each in told],
        "missed_ticks": missed,
        "step_m": round(max(steps), 4),
    }


def _swap(client: Client, characters: list[Character], kind: ServiceKind, endpoint: str) -> float:
    """Put it in and see every character go on with it; milliseconds that the call took."""
    began_s = time.perf_counter()
    assert client.swap(kind, PLUGINS[kind], endpoint=endpoint).endpoint == endpoint
    took_ms = (time.perf_counter() - began_s) * 1e3
    before, made = [character.state().tick for character in characters], _asked(kind, endpoint)
    used = made + 2 * len(characters) if kind == "planner" else len(characters)
    until(lambda: _asked(kind, endpoint) >= used, f"all use the {kind} at {endpoint}")
    until(
        lambda: all(each.state().tick > tick + 5 for each, tick in zip(characters, before, strict=True)),
        f"all go on with the {kind} at {endpoint}",
    )
    assert all(character.info().status == "running" for character in characters)
    return took_ms


def _asked(kind: ServiceKind, endpoint: str) -> int:
    """Plans that a planner has made, characters that a tracker has."""
    with ServiceClient(endpoint, kind) as peer:
        detail = peer.ask(Health(), HealthReport).detail
    return int(detail["stand.plans" if kind == "planner" else "characters"])


def main() -> None:
    """Print the report."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--every", type=float, default=5.0)
    parser.add_argument("--seconds", type=float, default=60.0)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="swaps-") as folder:
        print(json.dumps(swaps(Path(folder), given.every, given.seconds), indent=1))


if __name__ == "__main__":
    main()
