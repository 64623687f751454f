"""The benchmark of overload counts what a server really answers, and judges memory by its trend."""

from __future__ import annotations

import asyncio
import itertools
from contextlib import suppress

import pytest

from benchmarks.flood import Told, flood
from benchmarks.overload import growth_mb, memory, post, sound

ANSWERS = (
    b"HTTP/1.1 202 Accepted\r\nContent-Length: 4\r\n\r\n{}\r\n",
    b"HTTP/1.1 429 Too Many Requests\r\nretry-after: 2\r\ncontent-length: 0\r\n\r\n",
    b"HTTP/1.1 503 Service Unavailable\r\ncontent-length: 2\r\n\r\n{}",
)
REQUEST = post("http://127.0.0.1:1", "/v1/characters", {"seed": 1})


async def answered(rounds: int) -> tuple[Told, list[bytes]]:
    """What a flood of one connection makes of the answers, each in two pieces; the last request is hung up on."""
    told, asked, over = Told(), list[bytes](), asyncio.Event()
    answers = itertools.chain.from_iterable(itertools.repeat(ANSWERS, rounds))

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(asyncio.IncompleteReadError):
            while True:
                asked.append(await reader.readexactly(len(REQUEST)))
                answer = next(answers, None)
                if answer is None:
                    over.set()
                    break
                writer.write(answer[:-3])
                await writer.drain()
                await asyncio.sleep(0)
                writer.write(answer[-3:])
        writer.close()

    async with await asyncio.start_server(serve, "127.0.0.1", 0) as server:
        port = server.sockets[0].getsockname()[1]
        asking = asyncio.ensure_future(flood(f"http://127.0.0.1:{port}", "127.0.0.1", 1, 1e6, lambda: REQUEST, told))
        await over.wait()
        while not told.broken:
            await asyncio.sleep(0)
        asking.cancel()
        await asyncio.gather(asking, return_exceptions=True)
    return told, asked


def test_a_flood_counts_every_answer_and_every_refusal_without_a_time() -> None:
    told, asked = asyncio.run(answered(5))
    assert told.statuses == {202: 5, 429: 5, 503: 5}
    assert (told.without_a_time, told.broken, told.took_ms.total()) == (5, 1, 5)
    assert set(asked) == {REQUEST}
    assert len(asked) == 16


def test_percentiles_of_counted_milliseconds() -> None:
    told = Told()
    assert told.percentile_ms(50) is None
    told.took_ms.update({1: 50, 7: 48, 300: 2})
    assert [told.percentile_ms(q) for q in (50, 98, 99)] == [1, 7, 300]


def test_memory_that_levels_off_has_not_grown_and_a_leak_has() -> None:
    level = [100.0, 150.0, 180.0, 200.0, 200.0, 201.0, 200.0, 201.0, 200.0]
    assert growth_mb(level) == 0.0
    leak = [(3600.0 * hour, 100.0 + 40.0 * hour) for hour in range(9)]
    assert memory(leak) == {
        "first_mb": 100.0, "last_mb": 420.0, "max_mb": 420.0, "mb_per_h_latter_half": 40.0, "growth_mb": 120.0,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("change", "good"),
    [
        ({}, True), ({"under": {"missed_share": 0.006}}, False), ({"memory": {"tracker": {"growth_mb": 99.0}}}, False),
        ({"commands": {"statuses": {"202": 1, "500": 1}, "refused_without_a_time": 0, "broken": 0}}, False),
        ({"commands": {"statuses": {"202": 1, "503": 1}, "refused_without_a_time": 1, "broken": 0}}, False),
    ],
)  # fmt: skip
def test_what_counts_as_good_order(change: dict[str, object], good: bool) -> None:
    side = {"statuses": {"202": 3, "503": 9}, "refused_without_a_time": 0, "broken": 0}
    result = {
        "commands": side, "more_characters": side, "under": {"missed_share": 0.0},
        "memory": {"tracker": {"growth_mb": 0.0}},
    }  # fmt: skip
    assert sound({**result, **change}) is good
