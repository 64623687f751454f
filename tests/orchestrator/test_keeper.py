"""What ends is started again where it was, and the others find it; pauses grow while it keeps ending."""

from __future__ import annotations

import os
import re
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from orchestrator.client import Client
from orchestrator.core.keeper import BackOff, Keeper, how_it_ended
from orchestrator.core.supervise import Stack
from tests.orchestrator.support import light
from tests.orchestrator.test_faults import LONG, wait_for_phase

QUICK = BackOff(first_s=0.1, longest_s=0.4, calm_s=3600.0)
NAMES = ("planner", "tracker", "orchestrator")


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    """A stack of its own: its processes are killed."""
    with Stack(light(tmp_path_factory.mktemp("data"))) as stack:
        yield stack


def look_until(keeper: Keeper, condition: Callable[[], bool], what: str, give_up_s: float = 90.0) -> None:
    until = time.monotonic() + give_up_s
    while not condition():
        assert time.monotonic() < until, f"never: {what}"
        keeper.look()
        time.sleep(0.05)


def pid_of(stack: Stack, name: str) -> int:
    return next(process.pid for process in stack.processes() if process.name == name)


def test_pauses_double_up_to_the_longest() -> None:
    pauses = [BackOff(0.5, 30.0).pause_s(ended) for ended in (1, 2, 3, 6, 7, 8, 10_000)]
    assert pauses == [0.5, 1.0, 2.0, 16.0, 30.0, 30.0, 30.0]


def test_an_end_in_words() -> None:
    assert how_it_ended(3) == "ended with code 3"
    assert how_it_ended(-signal.SIGKILL) == "was killed by SIGKILL"
    assert how_it_ended(-99) == "was killed by signal 99"


@pytest.mark.parametrize("name", NAMES)
def test_a_killed_process_is_back_at_its_address_and_used(running: Stack, name: str) -> None:
    said: list[str] = []
    keeper = Keeper(running, said.append, QUICK)
    before = {process.name: (process.pid, process.address) for process in running.processes()}
    os.kill(pid_of(running, name), signal.SIGKILL)
    look_until(keeper, lambda: bool(said) and said[-1].endswith("is back"), f"the {name} is back")
    assert said[0] == f"{name} was killed by SIGKILL; it is started again in 0.1 s"
    assert keeper.restarts == {**dict.fromkeys(NAMES, 0), name: 1}
    for process in running.processes():
        assert process.address == before[process.name][1]
        assert (process.pid != before[process.name][0]) == (process.name == name)
    with Client(running.url) as client:
        look_until(keeper, client.ready, "all three work together")
        with client.character(pacing="lockstep") as character:
            assert character.step(3).tick == 3
    assert not running.dead()


def test_a_killed_planner_is_started_again_and_the_episode_goes_on(running: Stack) -> None:
    keeper = Keeper(running, lambda line: None, QUICK)
    with Client(running.url) as client:
        episode = client.episode(LONG, pacing="realtime")
        wait_for_phase(client, episode.id, "acting")
        os.kill(running.planner.pid, signal.SIGKILL)
        wait_for_phase(client, episode.id, "degraded")
        look_until(keeper, lambda: client.episodes[episode.id].info().phase == "acting", "it acts again")
        episode.cancel()
        kinds = [event.type for event in client.episodes[episode.id].events()]
    assert kinds.index("planner_lost") < kinds.index("planner_back")


def test_one_that_keeps_ending_is_given_longer_pauses_and_does_not_hold_up_another(running: Stack) -> None:
    said: list[str] = []
    keeper = Keeper(running, said.append, QUICK)
    for restarts in range(4):
        os.kill(running.planner.pid, signal.SIGKILL)
        look_until(keeper, lambda wanted=restarts + 1: keeper.restarts["planner"] == wanted, "started again")
    pauses = [re.findall(r"[\d.]+(?= s$)", line)[0] for line in said if "killed" in line]
    assert pauses == ["0.1", "0.2", "0.4", "0.4"]
    assert "for the 4th time in a row" in said[-1]
    os.kill(running.tracker.pid, signal.SIGTERM)
    look_until(keeper, lambda: sum("is back" in line for line in said) == 2, "both are back")
    assert any(line.startswith("tracker ended with code 0;") for line in said)


def test_a_calm_time_ends_a_row(running: Stack, tmp_path: Path) -> None:
    now_s = 0.0
    said: list[str] = []
    keeper = Keeper(running, said.append, BackOff(first_s=1.0, calm_s=60.0), clock=lambda: now_s)
    for ran_s, words in (
        (0.0, "again in 1 s"),
        (5.0, "2nd time in a row; it is started again in 2 s"),
        (61.0, "in 1 s"),
    ):
        now_s += ran_s
        os.kill(running.planner.pid, signal.SIGKILL)
        look_until(keeper, lambda: not running.planner.alive and "it is started" in (said or [""])[-1], "noticed")
        assert words in said[-1]
        assert ("row" in said[-1]) == ("row" in words)
        now_s += 2.5
        look_until(keeper, lambda: "is back" in said[-1], "back")


def test_one_that_never_gets_ready_counts_as_ended(running: Stack) -> None:
    said: list[str] = []
    keeper = Keeper(running, said.append, QUICK, ready_timeout_s=0.0)
    os.kill(running.planner.pid, signal.SIGKILL)
    look_until(keeper, lambda: keeper.restarts["planner"] == 2, "started twice")
    assert any("planner was not ready after 0 s for the 2nd time in a row" in line for line in said)
    patient = Keeper(running, said.append, QUICK)
    patient.look()
    with Client(running.url) as client:
        look_until(patient, client.ready, "the last start gets there when it is left alone")
