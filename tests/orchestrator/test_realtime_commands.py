"""A command to a realtime character is what the very next plan is made for, whenever it comes."""

from __future__ import annotations

import asyncio
import threading
import time
from pathlib import Path

from orchestrator.core.character import CharacterSession, CharacterSpec
from orchestrator.core.command import Command, Target
from orchestrator.core.events import EventLog
from orchestrator.core.lead import ROOMY_TICKS, PlanLead
from orchestrator.core.services import Services, connect
from orchestrator.core.supervise import Stack
from planner_service.builtin.stand import StandPlanner
from shared.protocol.control import Health, HealthReport
from shared.protocol.messages import TICK_HZ, Plan, PlanRequest
from tests.orchestrator.support import Noting, light, served

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


class Held:
    """Stands; plans for no one while it is held."""

    def __init__(self) -> None:
        self.spec, self.free, self.entered = StandPlanner().spec, threading.Event(), threading.Event()
        self.free.set()

    def plan(self, requests: list[PlanRequest]) -> list[Plan]:
        self.entered.set()
        assert self.free.wait(GIVE_UP_S)
        return StandPlanner().plan(requests)


async def asked_for_while_held(planner: str, tracker: str, held: Held) -> float:
    """Requests that the planner has not answered, once a command came while it made a plan that goes on."""
    services = Services(await connect(planner, "planner", "stand"), await connect(tracker, "tracker", "kinematic"))
    session = CharacterSession("held", CharacterSpec(pacing="realtime"), services, EventLog())
    try:
        await session.start()
        await texts_planned(session, 0)
        held.free.clear()
        held.entered.clear()
        await asyncio.to_thread(held.entered.wait, GIVE_UP_S)
        session.set_command(Command(text="wave"))
        waiting = 0.0
        while waiting < 3:  # the plan under way, the one for the command, and the question itself
            report = await services.planner.ask(HealthReport, Health())
            waiting = float(report.detail["pending"])
        return waiting
    finally:
        held.free.set()
        await session.close()
        await services.close()


def test_a_command_does_not_wait_until_what_goes_on_is_planned(tmp_path: Path) -> None:
    held = Held()
    with served(held, tmp_path) as endpoints:
        assert asyncio.run(asyncio.wait_for(asked_for_while_held(*endpoints, held), GIVE_UP_S)) == 3


async def asked_ahead(planner: str, tracker: str, noting: Noting) -> dict[str, list[int]]:
    """How many frames ahead plans were asked for: those that go on, one for a command, and those with a target."""
    services = Services(await connect(planner, "planner", "stand"), await connect(tracker, "tracker", "kinematic"))
    services.leads["stand"] = PlanLead(lambda: 0.0)  # plans take no time, however busy this machine is
    session = CharacterSession("ahead", CharacterSpec(pacing="realtime"), services, EventLog())

    async def noted(more_than: int) -> list[int]:
        while len(noting.asked) <= more_than:
            await asyncio.sleep(0.005)
        return [request.context_frames for request in noting.asked]

    try:
        await session.start()
        await texts_planned(session, 3)
        session.set_command(Command(text="wave"))
        while "wave" not in await texts_planned(session, 3):
            await asyncio.sleep(0.005)
        said = next(request for request in noting.asked if request.text == "wave")
        session.set_command(Command(text="walk", target=Target(joint="traj", position_m=(1.0, 0.0, 0.0))))
        while not (aimed := [i for i, request in enumerate(noting.asked) if request.targets]):
            await asyncio.sleep(0.005)
        return {
            "goes on": (await noted(2))[1:3],
            "command": [said.context_frames],
            "target": [min((await noted(aimed[0] + 12))[-10:])],  # two early in four seconds: some enter later
        }
    finally:
        await session.close()
        await services.close()


def test_only_what_goes_on_without_an_aim_is_asked_for_early(tmp_path: Path) -> None:
    noting = Noting(prefix_frames=20)
    with served(noting, tmp_path) as endpoints:
        ahead = asyncio.run(asyncio.wait_for(asked_ahead(*endpoints, noting), GIVE_UP_S))
    roomy = ROOMY_TICKS * noting.spec.fps // TICK_HZ
    assert min(ahead["goes on"]) >= roomy
    assert max(ahead["command"] + ahead["target"]) < roomy
