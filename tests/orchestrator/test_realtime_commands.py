"""A command to a realtime character is what the very next plan is made for, whenever it comes."""

from __future__ import annotations

import asyncio
import threading
import time
from pathlib import Path

from orchestrator.core.character import CharacterSession, CharacterSpec
from orchestrator.core.command import Command
from orchestrator.core.events import EventLog
from orchestrator.core.services import Services, connect
from orchestrator.core.supervise import Stack
from planner_service.builtin.stand import StandPlanner
from shared.protocol.messages import Plan, PlanRequest
from tests.orchestrator.support import light, served

GIVE_UP_S = 60.0


async def texts_planned(session: CharacterSession, more_than: int) -> list[str | None]:
    """Texts of all plans so far, once there are more than so many."""
    while True:
        texts = [event.data["text"] for event in session.events.since(0) if event.type == "plan"]
        if len(texts) > more_than:
            return texts
        await asyncio.sleep(0.005)


async def command_three_times(planner: str, tracker: str) -> None:
    services = Services(
        await connect(planner, "planner", "stand"), await connect(tracker, "tracker", "kinematic")
    )  # fmt: skip
    session = CharacterSession("listener", CharacterSpec(pacing="realtime"), services, EventLog())
    try:
        await session.start()
        seen = await texts_planned(session, 0)
        for text in ("walk", "wave", "run"):
            # Right after a plan none is under way: the character is between two looks.
            session.set_command(Command(text=text))
            seen = await texts_planned(session, len(seen))
            assert seen[-1] == text
    finally:
        await session.close()
        await services.close()


def test_the_next_plan_is_for_the_new_command(tmp_path: Path) -> None:
    stack = Stack(light(tmp_path))
    try:
        endpoints = stack.start_services()
        asyncio.run(asyncio.wait_for(command_three_times(*endpoints), GIVE_UP_S))
    finally:
        stack.stop()


async def plans_after_a_command(planner: str, tracker: str, planning: threading.Event) -> list[str | None]:
    """Texts of the plans that the tracker was given after a command that came while one was made."""
    services = Services(await connect(planner, "planner", "stand"), await connect(tracker, "tracker", "kinematic"))
    session = CharacterSession("busy", CharacterSpec(pacing="realtime"), services, EventLog())
    try:
        await session.start()
        session.set_command(Command(text="walk"))
        while "walk" not in await texts_planned(session, 0):
            await asyncio.sleep(0.005)
        planning.clear()
        while not planning.is_set():  # of its own accord: a plan that goes on with the walk
            await asyncio.sleep(0.002)
        session.set_command(Command(text="wave"))
        before = len(await texts_planned(session, 0))
        while "wave" not in (seen := (await texts_planned(session, before))[before:]):
            await asyncio.sleep(0.005)
        return seen
    finally:
        await session.close()
        await services.close()


class Announcing:
    """Stands, after a tenth of a second, and says when it is asked to."""

    def __init__(self, asked: threading.Event) -> None:
        self.spec, self._asked = StandPlanner().spec, asked

    def plan(self, requests: list[PlanRequest]) -> list[Plan]:
        self._asked.set()
        time.sleep(0.1)
        return StandPlanner().plan(requests)


def test_what_only_goes_on_is_dropped_for_a_command(tmp_path: Path) -> None:
    asked = threading.Event()
    with served(Announcing(asked), tmp_path) as endpoints:
        planned = asyncio.run(asyncio.wait_for(plans_after_a_command(*endpoints, asked), GIVE_UP_S))
    assert planned[0] == "wave"
