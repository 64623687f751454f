"""A command to a realtime character is what the very next plan is made for, whenever it comes."""

from __future__ import annotations

import asyncio
from pathlib import Path

from orchestrator.core.character import CharacterSession, CharacterSpec
from orchestrator.core.command import Command
from orchestrator.core.events import EventLog
from orchestrator.core.services import Services, connect
from orchestrator.core.supervise import Stack
from tests.orchestrator.support import light

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
