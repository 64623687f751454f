"""The containers of docker-compose.yml from nothing: health, page, demo, kill -9 of each, three trackers, the end.

    make compose-check                                    # docker compose
    python -m benchmarks.compose_check --engine podman    # podman-compose, as root

The images must have been built. A project of its own is brought up, with volumes of its own, and taken down again.
Killing the first process of a container needs the rights for it.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import secrets
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ParamSpec

import httpx
import numpy as np

from orchestrator.cli.common import provenance, write_json
from orchestrator.client import Character, Client, Episode
from shared.errors import MotionLoopError

P = ParamSpec("P")
PROJECT = "motionloop-check"
SERVICES = ("planner", "tracker", "orchestrator")
COMPOSE = {"docker": ["docker", "compose"], "podman": ["podman-compose"]}
JOINS_NAMES = {"docker": "-", "podman": "_"}
STOP_S = 5.0
PATIENCE_S = 180.0
LOOK_S = 0.2
SPARE_TICKS = 31
"""By the clock some ticks pass before an end is noticed: a recording may hold them."""
TASK_S, TASKS = 20.0, 6
TRACKERS = 3
WALK = {"type": "text", "text": "a person is walking in a circle.", "duration_s": TASK_S}


class Composition:
    """The containers of the project.

    Args:
        engine: docker or podman.
        port: of this machine, for the orchestrator.
    """

    def __init__(self, engine: str, port: int):
        self._engine = engine
        self.url, self.token = f"http://127.0.0.1:{port}", secrets.token_hex(32)
        self._environment = {**os.environ, "MOTIONLOOP_TOKEN": self.token, "MOTIONLOOP_PORT": str(port)}

    def compose(self, *words: str, **environment: str) -> float:
        """Run a command of it; seconds that it took."""
        began_s = time.monotonic()
        command = [*COMPOSE[self._engine], "-p", PROJECT, *words]
        done = subprocess.run(
            command, env={**self._environment, **environment}, capture_output=True, text=True, check=False
        )
        if done.returncode:
            raise RuntimeError(f"{' '.join(command)} ended with {done.returncode}: {done.stderr[-2000:]}")
        return round(time.monotonic() - began_s, 1)

    def name(self, service: str, number: int = 1) -> str:
        """Of a container."""
        return JOINS_NAMES[self._engine].join((PROJECT, service, str(number)))

    def state(self, service: str) -> dict[str, Any]:
        """Of a service's first container, as the engine tells it."""
        found: dict[str, Any] = json.loads(self._run("inspect", self.name(service)))[0]["State"]
        return found

    def pid(self, service: str) -> int:
        """Of its first process."""
        return int(self.state(service)["Pid"])

    def healthy(self, service: str) -> bool:
        """As the compose file has it checked. Podman leaves the asking to systemd, which not every machine has."""
        if self._engine == "podman":
            command = ["podman", "healthcheck", "run", self.name(service)]
            return subprocess.run(command, capture_output=True, check=False).returncode == 0
        return bool(self.state(service)["Health"]["Status"] == "healthy")

    def image_mb(self, service: str) -> int:
        """Size of its image."""
        return round(int(json.loads(self._run("image", "inspect", f"motionloop-{service}"))[0]["Size"]) / 1e6)

    def left(self) -> list[str]:
        """Names of its containers, running or not."""
        return [name for name in self._run("ps", "-a", "--format", "{{.Names}}").split() if name.startswith(PROJECT)]

    def stop(self, name: str) -> float:
        """Stop one container as its compose file would have it; seconds."""
        began_s = time.monotonic()
        self._run("stop", "-t", str(round(STOP_S)), name)
        return round(time.monotonic() - began_s, 2)

    def _run(self, *words: str) -> str:
        return subprocess.run([self._engine, *words], capture_output=True, text=True, check=True).stdout


def until(what: str, holds: Callable[P, bool], *values: P.args, **named: P.kwargs) -> float:
    """Seconds until it holds; raises TimeoutError."""
    began_s = time.monotonic()
    while not holds(*values, **named):
        if time.monotonic() - began_s > PATIENCE_S:
            raise TimeoutError(f"not within {PATIENCE_S:g} s: {what}")
        time.sleep(LOOK_S)
    return round(time.monotonic() - began_s, 1)


def started(containers: Composition) -> dict[str, float]:
    """Bring it up; seconds until each service was healthy, and until all were ready."""
    began_s = time.monotonic()
    containers.compose("up", "-d", "--no-build")
    out = {"up": round(time.monotonic() - began_s, 1)}
    left = list(SERVICES)
    while left:
        until(f"one of {left} is healthy", lambda: any(map(containers.healthy, left)))
        for service in [each for each in left if containers.healthy(each)]:
            out[service] = round(time.monotonic() - began_s, 1)
            left.remove(service)
    with Client(containers.url, containers.token) as client:
        until("the orchestrator is ready", answered, client.ready)
    return {**out, "ready": round(time.monotonic() - began_s, 1)}


def answered(ask: Callable[[], bool]) -> bool:
    """What was answered; False where nobody is there."""
    try:
        return ask()
    except MotionLoopError:
        return False


def front(containers: Composition) -> dict[str, int]:
    """Statuses of page and API, with the token and without."""
    with httpx.Client(base_url=containers.url, timeout=30.0) as http:
        bearer = {"authorization": f"Bearer {containers.token}"}
        return {
            "page": http.get("/").status_code,
            "services": http.get("/v1/services", headers=bearer).status_code,
            "services_without_token": http.get("/v1/services").status_code,
        }


def demo(containers: Composition) -> dict[str, Any]:
    """The demo as a user runs it, but for the video."""
    command = [sys.executable, "-m", "motionloop", "demo", "--url", containers.url, "--out", "out/compose_demo"]
    began_s = time.monotonic()
    environment = {**os.environ, "MOTIONLOOP_TOKEN": containers.token}
    code = subprocess.run([*command, "--no-video"], env=environment, check=False).returncode
    return {"passed": code == 0, "seconds": round(time.monotonic() - began_s, 1)}


def killed(containers: Composition, client: Client, episode: Episode, service: str) -> dict[str, float]:
    """Kill the first process of a container; seconds until it runs, is healthy, and the episode and all else go on."""
    pid, tick = containers.pid(service), episode.info().tick or 0
    os.kill(pid, signal.SIGKILL)
    began_s = time.monotonic()
    until(f"{service} runs again", lambda: containers.pid(service) not in (0, pid))
    out = {"runs": time.monotonic() - began_s}
    until(f"{service} is healthy again", containers.healthy, service)
    out["healthy"] = time.monotonic() - began_s
    until("the episode goes on", goes_on, episode, tick)
    until("all is ready", answered, client.ready)
    out["whole"] = time.monotonic() - began_s
    return {name: round(seconds, 1) for name, seconds in out.items()}


def kills(containers: Composition, client: Client) -> dict[str, Any]:
    """Kill one container after the other under an episode by the clock; what became of both."""
    episode = client.episode([{**WALK, "name": f"walk {i}"} for i in range(TASKS)], pacing="realtime", scene="flat")
    out: dict[str, Any] = {}
    for service in SERVICES:
        until("the episode goes on", goes_on, episode, 0)
        out[service] = killed(containers, client, episode, service)
    over = episode.wait()
    with np.load(io.BytesIO(episode.export("npz")), allow_pickle=False) as recording:
        start, count = int(recording["start_tick"]), len(recording["body_pos_w_m"])
    told = [event.type for event in episode.events()]
    names = ("planner_lost", "planner_back", "tracker_lost", "tracker_back", "resumed")
    out["episode"] = {
        "status": over.status,
        "reason": over.reason,
        "ticks": over.tick,
        "none_missing_or_twice": start == 0 and 0 <= count - ((over.tick or 0) + 1) <= SPARE_TICKS,
        "events": {name: told.count(name) for name in names},
    }
    return out


def goes_on(episode: Episode, after: int) -> bool:
    """Whether it runs and its tick moves, beyond a given one."""
    try:
        first = episode.info()
        time.sleep(LOOK_S)
        second = episode.info()
    except MotionLoopError:
        return False
    return second.status == "running" and (second.tick or 0) > max(first.tick or 0, after)


def more_trackers(containers: Composition) -> dict[str, Any]:
    """Three trackers, named as the docs say, a character for each; all live on when the first tracker is stopped."""
    first, *spare = [f"tcp://{containers.name('tracker', 1 + i)}:5602" for i in range(TRACKERS)]
    named = {"MOTIONLOOP_TRACKER": first, "MOTIONLOOP_SPARE_TRACKERS": ",".join(spare)}
    began_s = time.monotonic()
    containers.compose("up", "-d", "--no-build", "--scale", f"tracker={TRACKERS}", **named)
    with Client(containers.url, containers.token) as client:
        until("all is ready", answered, client.ready)
        out: dict[str, Any] = {"ready_s": round(time.monotonic() - began_s, 1)}
        characters = [client.character(pacing="realtime", scene="flat") for _ in range(TRACKERS)]
        for each in characters:
            until("the characters move", moves, each)
        out["first_stopped_s"] = containers.stop(containers.name("tracker"))
        began_s = time.monotonic()
        for each in characters:
            until("each lives on", moves, each)
        return {**out, "all_live_on_s": round(time.monotonic() - began_s, 1)}


def moves(character: Character) -> bool:
    """Whether it has a clock that runs."""
    first = character.state().tick
    time.sleep(LOOK_S)
    return character.state().tick > first


@contextmanager
def taken_down(containers: Composition) -> Iterator[None]:
    """Nothing of the project before, nothing after."""
    containers.compose("down", "-v", "--remove-orphans")
    try:
        yield
    finally:
        containers.compose("down", "-v", "--remove-orphans")


def check(containers: Composition) -> dict[str, Any]:
    """All of it."""
    with taken_down(containers):
        out: dict[str, Any] = {"image_mb": {each: containers.image_mb(each) for each in SERVICES}}
        out["seconds_until"] = started(containers)
        out["front"] = front(containers)
        out["demo"] = demo(containers)
        with Client(containers.url, containers.token) as client:
            out["killed"] = kills(containers, client)
            client.character(pacing="realtime", scene="flat")
        out["stop_s"] = {each: containers.stop(containers.name(each)) for each in reversed(SERVICES)}
        out["exit_codes"] = {each: containers.state(each)["ExitCode"] for each in SERVICES}
        containers.compose("down", "--remove-orphans")
        out["more_trackers"] = more_trackers(containers)
        out["stop_all_s"] = containers.compose("stop")
        out["down_s"] = containers.compose("down", "--remove-orphans")
    return {**out, "left_behind": containers.left()}


def sound(found: dict[str, Any]) -> bool:
    """Whether all is as it must be."""
    episode = found["killed"]["episode"]
    return (
        found["front"] == {"page": 200, "services": 200, "services_without_token": 401}
        and found["demo"]["passed"]
        and episode["status"] == "finished"
        and episode["none_missing_or_twice"]
        and max(*found["stop_s"].values(), found["stop_all_s"]) <= STOP_S
        and not found["left_behind"]
        and set(found["exit_codes"].values()) == {0}
    )


def main() -> int:
    """Exit code 1 when something is not as it must be."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--engine", choices=sorted(COMPOSE), default="docker")
    parser.add_argument("--port", type=int, default=18080)
    parser.add_argument("--json", type=Path, default=None, help="write the result to this file")
    given = parser.parse_args()
    found = check(Composition(given.engine, given.port))
    command = " ".join(["python", "-m", "benchmarks.compose_check", *sys.argv[1:]])
    write_json(given.json, {**found, "sound": sound(found), **provenance(), "command": command})
    return 0 if sound(found) else 1


if __name__ == "__main__":
    sys.exit(main())
