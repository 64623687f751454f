"""What can be changed while an episode runs, and what becomes of a character that falls."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from typing import Any

import httpx
import pytest

from orchestrator.client import Client, ServerProblem
from orchestrator.core.agenda import Agenda
from orchestrator.core.character import CharacterSession, CharacterSpec
from orchestrator.core.command import Command
from orchestrator.core.events import EventLog
from orchestrator.core.on_fall import GET_UP_TEXT
from orchestrator.core.services import Services, connect
from orchestrator.core.supervise import Stack
from shared.tasks.object_specs import GetUpSpec, SitSpec
from shared.tasks.specs import HaltSpec

LONG: dict[str, Any] = {"type": "halt", "name": "long", "duration_s": 100}
SHORT: dict[str, Any] = {"type": "halt", "name": "short", "duration_s": 0.2, "settle_s": 0}


@pytest.fixture
def client(stack: Stack) -> Iterator[Client]:
    with Client(stack.url) as opened:
        yield opened


def halts(count: int) -> list[HaltSpec]:
    return [HaltSpec(name=str(i)) for i in range(count)]


def test_an_agenda_by_hand() -> None:
    agenda = Agenda(halts(2), "sequence", 1)
    assert agenda.take()[0] == 0
    assert agenda.insert(HaltSpec(name="next"), 0) == 2
    assert agenda.insert(HaltSpec(name="last"), 99) == 3
    assert agenda.insert(HaltSpec(name="second"), 1) == 4
    assert [agenda.take()[0] for _ in range(len(agenda))] == [2, 4, 1, 3]
    assert agenda.longest_s == Agenda(agenda.tasks, "sequence", 1).longest_s
    rise = GetUpSpec(retries=2)
    assert Agenda([rise], "sequence", 1).longest_s == 120 + (rise.time_limit_s + 10) * 3 + 2 * SitSpec().time_limit_s
    shuffled = [Agenda(halts(8), "random", seed) for seed in (1, 1, 2)]
    orders = [[agenda.take()[0] for _ in range(8)] for agenda in shuffled]
    assert orders[0] == orders[1] != orders[2]
    assert sorted(orders[2]) == list(range(8))


def test_tasks_are_skipped_and_inserted_while_an_episode_runs(client: Client) -> None:
    episode = client.episode([LONG, LONG], pacing="realtime")
    events = episode.events()
    begun = (event for event in events if event.type == "task_begin")
    assert next(begun).data["index"] == 0
    assert episode.insert(SHORT) == 2
    assert episode.skip() == 0
    assert next(begun).data["index"] == 2
    assert next(begun).data["index"] == 1
    assert episode.skip() == 1
    assert [event.type for event in events][-1] == "end"
    done = episode.info()
    assert [(task.index, task.name, task.success_strict, task.reason) for task in done.results] == [
        (0, "long", False, "skipped"), (2, "short", True, None), (1, "long", False, "skipped"),
    ]  # fmt: skip
    assert (done.status, done.success) == ("finished", False)
    for change in (episode.skip, lambda: episode.insert(SHORT)):
        with pytest.raises(ServerProblem, match="finished") as refused:
            change()
        assert refused.value.code == "conflict"


def test_a_wrong_task_is_refused_and_changes_nothing(client: Client, http: httpx.Client) -> None:
    episode = client.episode([LONG], pacing="realtime")
    for body in ({"task": {"type": "fly"}}, {"task": LONG, "place": -1}, {}, LONG):
        assert http.post(f"/v1/episodes/{episode.id}/insert", json=body).status_code == 422
    episode.cancel()
    assert not any(event.type == "task_inserted" for event in episode.events())


async def fall(
    planner: str, tracker: str, on_fall: str, plugin: str
) -> tuple[list[str], list[str | None], bool, str | None]:
    """Events after a push, texts planned after it, whether it lies at the end, and the command in force then."""
    services = Services(await connect(planner, "planner", "stand"), await connect(tracker, "tracker", plugin))
    spec = CharacterSpec.model_validate({"pacing": "lockstep", "on_fall": on_fall})
    session = CharacterSession(f"falls-{on_fall}-{plugin}", spec, services, EventLog())
    try:
        await session.start()
        session.set_command(Command(text="walk"))
        await session.advance(6)
        await session.impulse("spine3", (250.0, 0.0, 0.0))
        await session.advance(120)
        events = session.events.since(0)
        fallen = next(event.seq for event in events if event.type == "fallen")
        after = [event for event in events if event.seq > fallen]
        texts = [event.data["text"] for event in after if event.type == "plan"]
        return [event.type for event in after], texts, session.state.fallen, session.command.text
    finally:
        await session.close()
        await services.close()


@pytest.mark.parametrize(
    ("on_fall", "plugin", "then"),
    [("stay", "pd", "stay"), ("reset", "pd", "reset"), ("get_up", "learned", "get_up"), ("get_up", "pd", "reset")],
)
def test_what_becomes_of_a_character_that_falls(stack: Stack, on_fall: str, plugin: str, then: str) -> None:
    """Servos alone cannot get up: with them the body is put on its feet."""
    addresses = stack.planner.address, stack.tracker.address
    types, texts, lies, command = asyncio.run(fall(*addresses, on_fall, plugin))
    assert command == "walk", "the command goes on"
    assert ("reset" in types) == (then == "reset")
    assert ("getting_up" in types) == (then == "get_up")
    assert (GET_UP_TEXT in texts) == (then == "get_up")
    if on_fall == "stay":
        assert lies
