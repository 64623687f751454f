"""An episode survives the orchestrator: the next one takes it up where it was, and nothing recorded is lost."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import Any

import httpx
import pytest

from orchestrator.client import Client
from orchestrator.core.supervise import ServiceProcess, Stack
from shared.errors import MotionLoopError
from tests.orchestrator.support import arrays_of, kept_up, light, play
from tests.orchestrator.test_faults import LONG, wait_for, wait_for_phase
from tests.orchestrator.test_rescue import TASKS, check_whole, ended, under_way
from tests.planner_service.motion import write_library


def orchestrator_of(stack: Stack) -> ServiceProcess:
    assert stack.orchestrator is not None
    return stack.orchestrator


def answers(client: Client) -> bool:
    """Whether there is an orchestrator, connected to both services."""
    try:
        return client.ready()
    except MotionLoopError:
        return False


def kill_and_wait(stack: Stack, client: Client, *processes: ServiceProcess) -> None:
    """SIGKILL them; whoever keeps the stack up starts them again."""
    before = orchestrator_of(stack).pid
    for process in processes:
        os.kill(process.pid, signal.SIGKILL)
    os.kill(stack.planner.pid, signal.SIGCONT)  # where a test has held it
    wait_for(lambda: orchestrator_of(stack).pid != before and answers(client), "all are back")


def kinds_of(client: Client, episode_id: str) -> list[str]:
    return [event.type for event in client.episodes[episode_id].events()]


@pytest.mark.parametrize("also_the_tracker", [False, True])
def test_a_lockstep_episode_is_the_same_with_and_without_a_kill_of_the_orchestrator(
    tmp_path: Path, also_the_tracker: bool
) -> None:
    options = light(tmp_path / "data", write_library(tmp_path / "library"))
    spec = {"tasks": TASKS, "pacing": "lockstep", "seed": 3, "planner": "clip", "tracker": "kinematic"}
    with Stack(options) as stack, httpx.Client(base_url=stack.url, timeout=120.0) as http, Client(stack.url) as client:
        told, wanted = play(http, spec)
        with kept_up(stack):
            episode_id = str(http.post("/v1/episodes", json=spec).json()["id"])
            next(event for event in client.episodes[episode_id].events() if event.tick >= 60)
            # Lockstep waits for its next plan, so that the quickest machine is still at it when the orchestrator dies.
            os.kill(stack.planner.pid, signal.SIGSTOP)
            kept = tmp_path / "data" / "recordings" / f"{episode_id}.parts" / "resume.state"
            wait_for(kept.is_file, "kept")
            kill_and_wait(stack, client, orchestrator_of(stack), *([stack.tracker] if also_the_tracker else []))
            assert ended(client, episode_id)["status"] == "finished"
            assert kinds_of(client, episode_id).count("resumed") == 1
            assert arrays_of(http, episode_id) == wanted
            outcome = http.get(f"/v1/episodes/{episode_id}").json()["outcome"]
            assert outcome == told["outcome"]


@pytest.mark.parametrize("also_the_tracker", [False, True])
def test_a_realtime_episode_goes_on_after_a_kill_of_the_orchestrator(tmp_path: Path, also_the_tracker: bool) -> None:
    with Stack(light(tmp_path)) as stack, Client(stack.url) as client, kept_up(stack):
        episode_id = client.episode(LONG, pacing="realtime").id
        under_way(client, episode_id, 60)
        kill_and_wait(stack, client, orchestrator_of(stack), *([stack.tracker] if also_the_tracker else []))
        wait_for_phase(client, episode_id, "acting")
        tick = client.episodes[episode_id].info().tick or 0
        assert tick >= 1  # it did not begin anew
        under_way(client, episode_id, tick + 30)
        client.episodes[episode_id].cancel()
        assert ended(client, episode_id)["status"] == "cancelled"
        kinds = kinds_of(client, episode_id)
        assert kinds.count("task_begin") == 1 and kinds.index("resumed") > kinds.index("task_begin")
        check_whole(tmp_path / "recordings" / f"{episode_id}.npz", client.episodes[episode_id].info().tick or 0)


def test_a_stop_of_everything_leaves_episodes_to_the_next_start(tmp_path: Path) -> None:
    with Stack(light(tmp_path)) as stack, Client(stack.url) as client:
        episodes = [client.episode(LONG, pacing=pacing).id for pacing in ("realtime", "lockstep")]
        over = client.episode([{"type": "halt", "duration_s": 1}]).id
        ended(client, over)
        under_way(client, episodes[0], 45)
        held = client.character().id
    with Stack(light(tmp_path)) as stack, Client(stack.url) as client:
        assert client.episodes[over].info().status == "finished"
        assert ended(client, episodes[1])["status"] == "finished"
        wait_for_phase(client, episodes[0], "acting")
        assert (client.episodes[episodes[0]].info().tick or 0) >= 15
        client.episodes[episodes[0]].cancel()
        ended(client, episodes[0])
        assert len(client.characters) == 0 and held


def test_an_episode_that_cannot_be_taken_up_is_interrupted_with_what_was_recorded(tmp_path: Path) -> None:
    with Stack(light(tmp_path)) as stack, Client(stack.url) as client:
        episode_id = client.episode(LONG, pacing="realtime").id
        under_way(client, episode_id, 60)
        wait_for((tmp_path / "recordings" / f"{episode_id}.parts" / "resume.state").is_file, "kept")
        os.kill(orchestrator_of(stack).pid, signal.SIGKILL)
        wait_for(lambda: bool(stack.dead()), "noticed")
    resume = tmp_path / "recordings" / f"{episode_id}.parts" / "resume.state"
    resume.write_bytes(resume.read_bytes()[:1000])
    with Stack(light(tmp_path)) as stack, Client(stack.url) as client:
        told: Any = client.episodes[episode_id].info()
        assert told.status == "interrupted" and "stopped" in str(told.reason)
        assert client.episodes[episode_id].motion().duration_s > 0.0
