"""The asyncio client does what the blocking one does."""

from __future__ import annotations

import asyncio
import inspect
from pathlib import Path

import pytest

from motionloop import AsyncClient, Event, ServerProblem, State
from orchestrator.client import aio, sync
from orchestrator.core.supervise import Stack
from shared.errors import ConflictError, DeadlineError, UnavailableError

PAIRS = [
    (sync.Client, aio.AsyncClient),
    (sync.Character, aio.AsyncCharacter),
    (sync.Characters, aio.AsyncCharacters),
    (sync.Episode, aio.AsyncEpisode),
    (sync.Episodes, aio.AsyncEpisodes),
]


@pytest.mark.parametrize(("blocking", "asynchronous"), PAIRS)
def test_both_clients_have_the_same_methods(blocking: type, asynchronous: type) -> None:
    def methods(kind: type) -> dict[str, list[str]]:
        return {
            name: list(inspect.signature(member).parameters) if callable(member) else []
            for name, member in vars(kind).items()
            if not name.startswith("_")
        }

    assert methods(blocking) == methods(asynchronous)


def test_characters(stack: Stack, tmp_path: Path) -> None:
    async def run() -> None:
        async with AsyncClient(stack.url) as client:
            assert await client.ready()
            async with await client.character(pacing="lockstep", seed=1, tracker="pd") as character:
                await character.say("a person is standing still.")
                state = await character.step(15)
                assert isinstance(state, State)
                pushed = await character.push("spine3", (0.0, 40.0, 0.0))
                assert pushed.tick == 15
                assert (await character.motion(seconds=1)).start_tick == 0
                assert (await character.save(tmp_path / "m.csv")).read_text().startswith("tick,time_s,pelvis_x_m")
                found = await client.characters.get(character.id)
                assert (await found.state()).tick == 15
                assert character.id in [other.id async for other in client.characters]
                assert (await character.reset()).fallen is False
            with pytest.raises(ServerProblem, match="no character"):
                await character.info()
            with pytest.raises(ServerProblem, match="no character"):
                await anext(character.stream())

    asyncio.run(run())


def test_realtime_streams(stack: Stack) -> None:
    async def run() -> None:
        async with AsyncClient(stack.url) as client, await client.character(planner="clip") as character:
            await character.say("a person walks forward", target=(1.0, 0.0))
            ticks = []
            async for state in character.stream(timeout_s=30):
                ticks.append(state.tick)
                if len(ticks) == 5:
                    break
            assert ticks == sorted(set(ticks))
            async for event in character.events(timeout_s=30):
                assert isinstance(event, Event)
                if event.type == "plan":
                    break
            far = await character.wait_for(lambda state: state.pelvis_w_m[0] > 0.2, timeout_s=60)
            assert far.pelvis_w_m[0] > 0.2
            with pytest.raises(DeadlineError, match="did not hold"):
                await character.wait_for(lambda state: False, timeout_s=0.2)
            await character.pause()
            assert (await character.info()).status == "paused"
            await character.resume()

    asyncio.run(run())


def test_episodes_and_services(stack: Stack, tmp_path: Path) -> None:
    async def run() -> None:
        async with AsyncClient(stack.url) as client:
            seen: list[Event] = []
            episode = await client.episode([{"type": "halt", "settle_s": 0.5, "duration_s": 0.5}], seed=2)
            with pytest.raises(ConflictError):
                _ = episode.result
            result = await episode.wait(timeout_s=120, on_event=seen.append)
            assert result.success is True
            assert seen[-1].type == "end"
            assert len(await episode.motion()) == (result.tick or 0) + 1
            assert (await episode.save(tmp_path / "e.glb")).read_bytes().startswith(b"glTF")
            assert episode.id in [info.id for info in await client.episodes.all()]
            await (await client.episodes.get(episode.id)).delete()
            with pytest.raises(ServerProblem):
                await episode.info()
            endless = await client.episode([{"type": "halt", "duration_s": 100}], pacing="realtime")
            with pytest.raises(DeadlineError, match="cancel"):
                await endless.wait(timeout_s=0.3)
            await endless.cancel()
            assert (await endless.wait(timeout_s=60)).status == "cancelled"
            assert (await client.services()).planner.plugin == "stand"
            assert (await client.swap("planner", "stand")).plugin == "stand"

    asyncio.run(run())


def test_without_a_server() -> None:
    async def run() -> None:
        async with AsyncClient("http://127.0.0.1:1") as client:
            assert not await client.ready()
            with pytest.raises(UnavailableError, match="motionloop serve all"):
                await client.services()

    asyncio.run(run())
