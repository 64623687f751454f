"""A service that is stopped in mid-episode leaves no hang: the others say what is missing and end or wait."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import psutil

from orchestrator.client import Client
from orchestrator.core.supervise import Stack
from shared.protocol.control import Health, HealthReport
from shared.protocol.transport import ServiceClient
from tests.orchestrator.support import light

LONG: list[dict[str, Any]] = [{"type": "halt", "duration_s": 60}]


def wait_for(condition: Callable[[], bool], what: str, give_up_s: float = 150.0) -> None:
    until = time.monotonic() + give_up_s
    while not condition():
        assert time.monotonic() < until, f"never: {what}"
        time.sleep(0.1)


def wait_for_phase(client: Client, episode_id: str, phase: str) -> None:
    def reached() -> bool:
        episode = client.episodes[episode_id].info()
        assert episode.status == "running", f"{episode.status}: {episode.reason}"
        return episode.phase == phase

    wait_for(reached, phase)


def end_of(client: Client, episode_id: str) -> dict[str, Any]:
    """What the last event says; waits for it."""
    return next(event.data for event in client.episodes[episode_id].events() if event.type == "end")


def test_a_frozen_planner_degrades_the_episode_which_goes_on_when_it_is_back(tmp_path: Path) -> None:
    with Stack(light(tmp_path)) as stack, Client(stack.url) as client:
        episode_id = client.episode(LONG, pacing="realtime").id
        wait_for_phase(client, episode_id, "acting")
        os.kill(stack.planner.pid, signal.SIGSTOP)
        try:
            wait_for_phase(client, episode_id, "degraded")
            tick = client.episodes[episode_id].info().tick or 0
            wait_for(lambda: (client.episodes[episode_id].info().tick or 0) > tick, "the physics goes on")
        finally:
            os.kill(stack.planner.pid, signal.SIGCONT)
        wait_for_phase(client, episode_id, "acting")
        client.episodes[episode_id].cancel()
        kinds = [event.type for event in client.episodes[episode_id].events()]
        assert kinds.index("planner_lost") < kinds.index("planner_back")


def test_a_killed_planner_leaves_the_physics_running_until_the_episodes_limit(tmp_path: Path) -> None:
    with Stack(light(tmp_path)) as stack, Client(stack.url) as client:
        episode_id = client.episode(LONG, pacing="realtime", time_limit_s=12).id
        wait_for_phase(client, episode_id, "acting")
        os.kill(stack.planner.pid, signal.SIGKILL)
        assert not client.ready()
        end = end_of(client, episode_id)
        events = {event.type: event for event in client.episodes[episode_id].events()}
        assert "answer" in (said := str(events["planner_lost"].data["reason"])) or "PlanRequest" in said
        assert (end["status"], end["reason"]) == ("failed", "the episode's time limit was reached")
        # By the wall clock ticks pass before the limit is noticed.
        assert (client.episodes[episode_id].info().tick or 0) >= 360


def test_a_stopped_orchestrator_ends_cleanly_and_the_services_wait_for_the_next(tmp_path: Path) -> None:
    with Stack(light(tmp_path)) as stack:
        with Client(stack.url) as client:
            episode_id = client.episode(LONG, pacing="realtime").id
            wait_for_phase(client, episode_id, "acting")
        orchestrator = stack.orchestrator
        assert orchestrator is not None
        with httpx.stream("GET", f"{stack.url}/v1/episodes/{episode_id}/events", timeout=150.0) as stream:
            lines = stream.iter_lines()
            assert next(lines)
            os.kill(orchestrator.pid, signal.SIGTERM)
            for _ in lines:  # to its end: it is not cut off in the midst of what it says
                continue
        wait_for(lambda: orchestrator.exit_code is not None, "it ends")
        assert orchestrator.exit_code == 0
        for process, kind in ((stack.planner, "planner"), (stack.tracker, "tracker")):
            with ServiceClient(process.address, kind) as peer:  # type: ignore[arg-type]
                assert peer.ask(Health(), HealthReport, timeout_s=10.0).status == "ok"


def test_the_stack_leaves_no_process_behind(tmp_path: Path) -> None:
    with Stack(light(tmp_path)) as stack:
        orchestrator = stack.orchestrator
        assert orchestrator is not None
        pids = [stack.planner.pid, stack.tracker.pid, orchestrator.pid]
        os.kill(orchestrator.pid, signal.SIGKILL)
        wait_for(lambda: stack.dead() == ["orchestrator"], "noticed")
    assert not any(psutil.pid_exists(pid) for pid in pids)
