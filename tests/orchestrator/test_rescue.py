"""A character survives the death of its tracker: it is brought back from what was kept at its last plan."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import pytest

from orchestrator.client import Client
from orchestrator.core.character import CharacterSession, CharacterSpec
from orchestrator.core.events import EventLog
from orchestrator.core.services import Services, connect
from orchestrator.core.supervise import ServiceProcess, Stack
from orchestrator.rest import Event
from orchestrator.store.recordings import from_npz
from shared.errors import NotFoundError
from tests.orchestrator.support import arrays_of, kept_up, light, play, running, running_service
from tests.orchestrator.test_faults import LONG, wait_for
from tests.orchestrator.test_moving import hosted
from tests.planner_service.motion import write_library

TASKS: list[dict[str, Any]] = [
    {"type": "text", "text": "a person walks forward.", "duration_s": 30},
    {"type": "reach", "relative_m": [1.5, 0.5], "time_limit_s": 8},
    {"type": "halt", "duration_s": 3},
]
"""Long enough that a kill soon after the start comes within the first."""


@pytest.fixture
def second() -> Iterator[ServiceProcess]:
    """Another tracker service."""
    with running_service("tracker_service") as process:
        yield process


def first_event(client: Client, episode_id: str, kind: str) -> Event:
    """The first event of a type, waited for."""
    return next(event for event in client.episodes[episode_id].events() if event.type in (kind, "end"))


def under_way(client: Client, episode_id: str, ticks: int) -> None:
    wait_for(lambda: (client.episodes[episode_id].info().tick or 0) >= ticks, f"tick {ticks}")


def ended(client: Client, episode_id: str) -> dict[str, Any]:
    return first_event(client, episode_id, "end").data


def check_whole(recording: Path, stop_tick: int) -> None:
    """It holds the ticks from 0 to `stop_tick`, or a few more: by the clock some pass before an end is noticed."""
    kept = from_npz(recording)
    assert kept.start_tick == 0
    assert len(kept) > stop_tick


def test_a_lockstep_episode_is_the_same_with_and_without_the_death_of_its_tracker(tmp_path: Path) -> None:
    """Tick by tick: it goes on from the snapshot of its last plan as if nothing had been. In the midst of a task;
    test_put_back.py has the other moments."""
    options = light(tmp_path / "data", write_library(tmp_path / "library"))
    spec = {"tasks": TASKS, "pacing": "lockstep", "seed": 3, "planner": "clip", "tracker": "pd"}
    with Stack(options) as stack, httpx.Client(base_url=stack.url, timeout=120.0) as http, Client(stack.url) as client:
        told, wanted = play(http, spec)
        with kept_up(stack):
            episode_id = str(http.post("/v1/episodes", json=spec).json()["id"])
            next(event for event in client.episodes[episode_id].events() if event.tick >= 60)
            # Lockstep waits for its next plan, so that the quickest machine is still at it when the tracker dies.
            os.kill(stack.planner.pid, signal.SIGSTOP)
            os.kill(stack.tracker.pid, signal.SIGKILL)
            os.kill(stack.planner.pid, signal.SIGCONT)
            assert ended(client, episode_id)["status"] == "finished"
            back = first_event(client, episode_id, "tracker_back")
            assert back.data["endpoint"] == stack.tracker.address
            assert arrays_of(http, episode_id) == wanted
            assert http.get(f"/v1/episodes/{episode_id}").json()["outcome"] == told["outcome"]


def test_a_realtime_episode_goes_on_at_the_tracker_that_is_started_again(tmp_path: Path) -> None:
    with Stack(light(tmp_path)) as stack, Client(stack.url) as client, kept_up(stack):
        episode_id = client.episode(LONG, pacing="realtime").id
        under_way(client, episode_id, 45)
        os.kill(stack.tracker.pid, signal.SIGKILL)
        back = first_event(client, episode_id, "tracker_back")
        # What is lost is what came after the last plan was kept; it did not begin anew.
        assert back.type == "tracker_back" and back.data["lost_ticks"] >= 0 and back.tick > 0
        under_way(client, episode_id, back.tick + 60)
        client.episodes[episode_id].cancel()
        assert ended(client, episode_id)["status"] == "cancelled"
        check_whole(tmp_path / "recordings" / f"{episode_id}.npz", client.episodes[episode_id].info().tick or 0)


def test_characters_are_spread_over_trackers_and_one_takes_over_those_of_another(
    tmp_path: Path, second: ServiceProcess
) -> None:
    options = replace(light(tmp_path), orchestrator_args=("--spare-trackers", second.address))
    with Stack(options) as stack, Client(stack.url) as client:
        episodes = [client.episode(LONG, pacing=pacing).id for pacing in ("realtime", "lockstep", "realtime")]
        under_way(client, episodes[2], 45)
        assert (hosted(stack.tracker.address), hosted(second.address)) == (2, 1)
        os.kill(stack.tracker.pid, signal.SIGKILL)
        back = first_event(client, episodes[2], "tracker_back")
        assert back.data["endpoint"] == second.address
        under_way(client, episodes[2], back.tick + 45)
        assert ended(client, episodes[1])["status"] == "finished"
        assert first_event(client, episodes[0], "tracker_back").type == "tracker_back"
        assert hosted(second.address) >= 2
        for episode_id in (episodes[0], episodes[2]):
            client.episodes[episode_id].cancel()
            ended(client, episode_id)


def test_a_spare_tracker_that_is_down_holds_nothing_up_and_is_used_once_it_is_there(tmp_path: Path) -> None:
    with running_service("tracker_service") as process:
        address = process.address  # nothing is there any more afterwards
    options = replace(light(tmp_path), orchestrator_args=("--spare-trackers", address))
    command = (sys.executable, "-m", "tracker_service", "--endpoint", address)
    with Stack(options) as stack, Client(stack.url) as client, client.character(), running("late", *command):

        def comes_there() -> bool:
            """The least loaded takes a character in."""
            with client.character():
                return hosted(address) == 1

        wait_for(comes_there, "a character lives at the tracker that came late")


def test_a_frozen_tracker_is_gone_on_with_when_it_thaws(tmp_path: Path) -> None:
    with Stack(light(tmp_path)) as stack, Client(stack.url) as client:
        episode_id = client.episode(LONG, pacing="realtime").id
        under_way(client, episode_id, 45)
        os.kill(stack.tracker.pid, signal.SIGSTOP)
        try:
            assert first_event(client, episode_id, "tracker_lost").type == "tracker_lost"
        finally:
            os.kill(stack.tracker.pid, signal.SIGCONT)
        back = first_event(client, episode_id, "tracker_back")
        assert (back.type, back.data["lost_ticks"]) == ("tracker_back", 0)
        under_way(client, episode_id, back.tick + 30)
        client.episodes[episode_id].cancel()
        ended(client, episode_id)
        check_whole(tmp_path / "recordings" / f"{episode_id}.npz", client.episodes[episode_id].info().tick or 0)


def test_a_commanded_character_is_degraded_while_its_tracker_is_away_and_stays_paused(tmp_path: Path) -> None:
    with Stack(light(tmp_path)) as stack, Client(stack.url) as client, client.character() as walker:
        held = client.character()
        held.pause()
        wait_for(lambda: walker.state().tick >= 45, "it runs")
        os.kill(stack.tracker.pid, signal.SIGKILL)
        wait_for(lambda: walker.info().status == "degraded", "it says so")
        with kept_up(stack):
            wait_for(lambda: walker.info().status == "running", "it is back")
            tick = walker.state().tick
            wait_for(lambda: walker.state().tick >= tick + 30, "its clock runs")
            next(event for event in held.events() if event.type == "tracker_back")
            still, tick = held.state().tick, walker.state().tick
            wait_for(lambda: walker.state().tick >= tick + 15, "time passes")
            assert (held.info().status, held.state().tick) == ("paused", still)
            held.resume()
            wait_for(lambda: held.state().tick >= still + 15, "it goes on when it is let")
        held.close()


def test_without_rescue_a_lost_tracker_ends_the_episode_with_the_reason(tmp_path: Path) -> None:
    options = replace(light(tmp_path), orchestrator_args=("--rescue-s", "0"))
    with Stack(options) as stack, Client(stack.url) as client:
        # Longer than any machine takes to come to the kill.
        episodes = [client.episode(LONG * 100, pacing=pacing).id for pacing in ("realtime", "lockstep")]
        under_way(client, episodes[0], 10)
        os.kill(stack.tracker.pid, signal.SIGKILL)
        for episode_id in episodes:
            end = ended(client, episode_id)
            assert end["status"] == "failed"
            assert "tracker is gone" in str(end["reason"])
        assert not client.ready()


def test_an_episode_that_waits_for_its_tracker_can_be_cancelled(tmp_path: Path) -> None:
    with Stack(light(tmp_path)) as stack, Client(stack.url) as client:
        episode_id = client.episode(LONG, pacing="realtime").id
        under_way(client, episode_id, 10)
        os.kill(stack.tracker.pid, signal.SIGKILL)
        assert first_event(client, episode_id, "tracker_lost").type == "tracker_lost"
        client.episodes[episode_id].cancel()
        assert ended(client, episode_id)["status"] == "cancelled"


def test_a_character_that_could_not_be_made_counts_nowhere(stack: Stack) -> None:
    """Else a tracker that refuses some would look full, and the others get all."""

    async def run() -> None:
        planner, tracker = stack.planner.address, stack.tracker.address
        services = Services(await connect(planner, "planner", "stand"), await connect(tracker, "tracker", "kinematic"))
        try:
            with pytest.raises(NotFoundError):
                await CharacterSession("refused", CharacterSpec(scene="moon"), services, EventLog()).start()
            assert services.residents == {}
            made = CharacterSession("made", CharacterSpec(), services, EventLog())
            await made.start()
            assert list(services.residents) == ["made"]
            await made.close()
            assert services.residents == {}
        finally:
            await services.close()

    asyncio.run(run())
