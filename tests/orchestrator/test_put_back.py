"""A tracker that dies at the worst moment, or an orchestrator that ends: the episode is tick by tick as without, with
physics too."""

from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from orchestrator.core.agenda import Agenda
from orchestrator.core.episode_spec import EpisodeSpec
from orchestrator.core.manager import Orchestrator
from orchestrator.core.supervise import Stack
from orchestrator.rest import Event
from shared.tasks.factory import TaskSpec
from shared.tasks.specs import HaltSpec
from tests.orchestrator.support import arrays_in, light, orchestrator_on
from tests.planner_service.motion import write_library

TOPPLING = {
    "name": "toppling",
    "bodies": [
        {
            "name": "bag",
            "position_w_m": [2.0, 0, 0],
            "parts": [
                {"shape": "cylinder", "size_m": [0.1, 0.5], "position_b_m": [0, 0, 0.5], "mass_kg": 5},
                {"shape": "sphere", "size_m": [0.1], "position_b_m": [0.4, 0, 0.9], "mass_kg": 20},
            ],
        }
    ],
    "marks": {"bag_centre": {"body": "bag", "position_b_m": [0, 0, 0.9]}},
}
"""Its bag stands by no means, so that it is set up before it is struck."""

SPEC = EpisodeSpec.model_validate(
    {
        "scene": TOPPLING,
        "tasks": [
            {"type": "halt", "duration_s": 1},
            {"type": "text", "text": "a person walks forward.", "duration_s": 2},
            {"type": "strike", "time_limit_s": 2},
            {"type": "reach", "relative_m": [0.6, 0.4], "time_limit_s": 2},
        ],
        "pacing": "lockstep",
        "seed": 3,
        "planner": "clip",
        "tracker": "pd",
    }
)

Moment = Callable[[Event], bool]
MOMENTS: dict[str, Moment] = {
    "the first task begins": lambda event: event.type == "task_begin" and event.data["index"] == 0,
    "the second task begins": lambda event: event.type == "task_begin" and event.data["index"] == 1,
    "an object is to be put somewhere": lambda event: event.type == "task_end" and event.data["index"] == 1,
    "it has fallen": lambda event: event.type == "state" and event.data["after"] == "recovering",
    "the episode ends": lambda event: event.type == "state" and event.data["after"] == "finished",
}
"""All of them between two moments at which something is kept of the character."""


def murderer(stack: Stack, moment: Moment, done: list[Event]) -> Callable[[Event], None]:
    """Kills the tracker within the first event that is the moment, and starts another in its place."""

    def see(event: Event) -> None:
        if not done and moment(event):
            done.append(event)
            os.kill(stack.tracker.pid, signal.SIGKILL)
            stack.restart("tracker")

    return see


async def played(
    stack: Stack, folder: Path, observe: Callable[[Event], None] | None = None
) -> tuple[dict[str, Any], dict[str, bytes], list[Event]]:
    """The episode's outcome, every array of its recording, and its events."""
    core = await orchestrator_on(stack, folder)
    events: list[Event] = []
    core.observers += [events.append, *([] if observe is None else [observe])]
    try:
        return *await finished(core, core.start_episode(SPEC)), events
    finally:
        await core.close()


async def finished(core: Orchestrator, episode_id: str) -> tuple[dict[str, Any], dict[str, bytes]]:
    """The outcome and the recording of an episode, once it has ended."""
    live = core.episodes[episode_id]
    assert live.task is not None
    await live.task
    assert live.outcome is not None
    return live.outcome.model_dump(mode="json"), arrays_in(core.files.path(episode_id))


async def left_and_taken_up(stack: Stack, folder: Path, moment: Moment) -> tuple[dict[str, Any], dict[str, bytes]]:
    """The same of one whose orchestrator ends at a moment, and which the next one takes up."""
    core, reached = await orchestrator_on(stack, folder), asyncio.Event()

    def see(event: Event) -> None:
        if moment(event):
            reached.set()

    core.observers.append(see)
    episode_id = core.start_episode(SPEC)
    await reached.wait()
    await core.close()
    assert core.episodes[episode_id].outcome is None
    core = await orchestrator_on(stack, folder)
    try:
        assert await core.recover() == []
        return await finished(core, episode_id)
    finally:
        await core.close()


def test_an_episode_with_physics_is_the_same_whenever_its_tracker_dies(tmp_path: Path) -> None:
    with_library = light(tmp_path / "data", write_library(tmp_path / "library"))
    stack = Stack(with_library)
    try:
        stack.start_services()
        wanted, ticks, told = asyncio.run(played(stack, tmp_path / "undisturbed"))
        assert [event.data["name"] for event in told if event.type == "object_set"] == ["bag"]
        assert wanted["status"] == "finished" and len(wanted["results"]) == len(SPEC.tasks)
        for what, moment in MOMENTS.items():
            assert any(moment(event) for event in told), f"never: {what}"
            done: list[Event] = []
            outcome, again, events = asyncio.run(played(stack, tmp_path / what, murderer(stack, moment, done)))
            back = [event for event in events if event.type == "tracker_back"]
            assert len(done) == 1 and len(back) == 1, what
            assert back[0].tick <= done[0].tick, what
            assert outcome == wanted, what
            assert [name for name in ticks if again[name] != ticks[name]] == [], what
        # The task that is taken up began with an object that had just been put elsewhere.
        put = next(event.tick for event in told if event.type == "object_set")
        left = left_and_taken_up(stack, tmp_path / "left", lambda event: event.type == "plan" and event.tick > put)
        outcome, again = asyncio.run(left)
        assert outcome == wanted
        assert [name for name in ticks if again[name] != ticks[name]] == []
    finally:
        stack.stop()


def halt(name: str) -> TaskSpec:
    return HaltSpec(type="halt", name=name)


def order_of(agenda: Agenda) -> list[str | None]:
    """The names of what is to come."""
    names = []
    while len(agenda):
        index, _ = agenda.take()
        names.append(agenda.tasks[index].name)
    return names


@pytest.mark.parametrize(("place", "order"), [(0, ["b", "new", "c"]), (1, ["b", "c", "new"]), (9, ["b", "c", "new"])])
def test_a_task_that_was_added_since_stays_added(place: int, order: list[str]) -> None:
    agenda = Agenda([halt("a"), halt("b"), halt("c")], "sequence", 0)
    agenda.take()
    kept, longest_s = agenda.remembered(), agenda.longest_s
    agenda.take()
    agenda.insert(halt("new"), place)
    with_it_s = agenda.longest_s
    agenda.put_back(kept)
    assert (agenda.longest_s, with_it_s > longest_s) == (with_it_s, True)
    assert order_of(agenda) == order
