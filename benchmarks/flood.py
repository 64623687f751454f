"""A flood of HTTP requests over kept connections, from several addresses of this machine, cheap enough to be many."""

from __future__ import annotations

import asyncio
import random
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from urllib.parse import urlsplit

HEAD_END = b"\r\n\r\n"
LENGTH, RETRY = b"content-length:", b"retry-after:"
AGAIN_S = 0.2
REFUSED = (429, 503)


@dataclass
class Told:
    """What was answered.

    Attributes:
        statuses: how many answers of each status.
        without_a_time: refusals that do not say when to come back.
        broken: connections that ended in the midst of a request.
        took_ms: whole milliseconds of answers that were no refusal, and how often.
    """

    statuses: Counter[int] = field(default_factory=Counter)
    without_a_time: int = 0
    broken: int = 0
    took_ms: Counter[int] = field(default_factory=Counter)

    def percentile_ms(self, percent: float) -> int | None:
        """Of `took_ms`; None where nothing was taken."""
        left = percent / 100 * sum(self.took_ms.values())
        for ms in sorted(self.took_ms):
            left -= self.took_ms[ms]
            if left <= 0:
                return ms
        return None


class Connection(asyncio.Protocol):
    """One request at a time, each when it is due; one that could not be sent in time is left out.

    Args:
        request: gives the next request, whole, as bytes.
        first_s: until the first request.
        every_s: between two requests.
        told: where answers are counted.
    """

    def __init__(self, request: Callable[[], bytes], first_s: float, every_s: float, told: Told):
        self._request, self._first_s, self._every_s, self._told = request, first_s, every_s, told
        self._transport: asyncio.Transport | None = None
        self._got = b""
        self._due_s = self._sent_s = 0.0
        self._asked = False
        self.ended = asyncio.get_running_loop().create_future()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin."""
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self._due_s = time.monotonic() + self._first_s
        asyncio.get_running_loop().call_later(self._first_s, self._ask)

    def data_received(self, data: bytes) -> None:
        """Count a whole answer, and ask again when it is time."""
        self._got += data
        end = self._got.find(HEAD_END)
        if end < 0:
            return
        head = self._got[:end].lower()
        if len(self._got) < end + len(HEAD_END) + _number(head, LENGTH):
            return
        self._got = b""
        self._asked = False
        self._count(int(head[9:12]), _number(head, RETRY))
        now_s = time.monotonic()
        self._due_s = max(self._due_s + self._every_s, now_s)
        asyncio.get_running_loop().call_later(self._due_s - now_s, self._ask)

    def connection_lost(self, exc: Exception | None) -> None:
        """The server has had enough, or we have."""
        if self._transport is not None:
            self._told.broken += self._asked
        self._transport = None
        if not self.ended.done():
            self.ended.set_result(None)

    def close(self) -> None:
        """We have had enough: what is under way does not count as broken."""
        if self._transport is not None:
            self._transport.close()
            self._transport = None

    def _ask(self) -> None:
        if self._transport is not None:
            self._sent_s, self._asked = time.monotonic(), True
            self._transport.write(self._request())

    def _count(self, status: int, retry_s: int) -> None:
        self._told.statuses[status] += 1
        if status in REFUSED:
            self._told.without_a_time += retry_s < 1
        else:
            self._told.took_ms[round((time.monotonic() - self._sent_s) * 1e3)] += 1


async def flood(
    url: str, caller: str, connections: int, per_s: float, request: Callable[[], bytes], told: Told
) -> None:
    """Until cancelled: `per_s` requests a second from address `caller`, over so many connections.

    Each connection begins at a moment of its own: in step they would ask at once and wait for each other.
    """
    where = urlsplit(url)
    host, port = str(where.hostname), where.port or 80
    every_s, rng = connections / per_s, random.Random(caller)

    async def keep() -> None:
        loop = asyncio.get_running_loop()
        while True:
            try:
                _, connection = await loop.create_connection(
                    lambda: Connection(request, every_s * rng.random(), every_s, told),
                    host, port, local_addr=(caller, 0),
                )  # fmt: skip
            except OSError:
                await asyncio.sleep(AGAIN_S)
                continue
            try:
                await connection.ended
            finally:
                connection.close()

    await asyncio.gather(*(keep() for _ in range(connections)))


def _number(head: bytes, name: bytes) -> int:
    """Of a header; 0 where it is missing."""
    at = head.find(b"\r\n" + name)
    if at < 0:
        return 0
    value = head[at + 2 + len(name) :].split(b"\r\n", 1)[0].strip()
    return int(value) if value.isdigit() else 0
