"""A proxy for the clients of a service that drops, delays, doubles, reorders and corrupts messages, by a seed."""

from __future__ import annotations

import contextlib
import random
import threading
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import zmq

FAULTS = ("drop", "delay", "double", "reorder", "corrupt")
DELAY_S = 0.15


@dataclass(frozen=True)
class _Held:
    """A message that is passed on later."""

    due_s: float
    client: bytes
    to_service: bool
    frames: list[bytes]


class ChaosProxy:
    """Stands before a service, at `endpoint`; a context manager. Each client has a connection of its own to it.

    What it does may be changed while it runs.

    Args:
        service: the endpoint of the service.
        seed: decides which messages are meddled with, and how.
        share: of the messages, either way, that have something done to them; 1 with `drop` alone cuts the line.
    """

    def __init__(self, service: str, seed: int, share: float):
        self.share = share
        self.faults: Sequence[str] = FAULTS
        self.done: Counter[str] = Counter()
        self._draw = random.Random(seed)
        self._service = service
        self._context: zmq.Context[Any] = zmq.Context()
        self._front = self._context.socket(zmq.ROUTER)
        self._front.linger = 0
        self._front.bind("tcp://127.0.0.1:*")
        self.endpoint = self._front.getsockopt(zmq.LAST_ENDPOINT).decode().rstrip("\0")
        self._backs: dict[bytes, zmq.Socket[Any]] = {}
        self._held: list[_Held] = []
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="chaos", daemon=True)

    def open(self) -> ChaosProxy:
        """Begin."""
        self._thread.start()
        return self

    def close(self) -> None:
        """End."""
        self._ending.set()
        self._thread.join()
        self._context.destroy(linger=0)

    def __enter__(self) -> ChaosProxy:
        return self.open()

    def __exit__(self, *_: object) -> None:
        self.close()

    def _run(self) -> None:
        poller = zmq.Poller()
        poller.register(self._front, zmq.POLLIN)
        while not self._ending.is_set():
            ready = dict(poller.poll(10))
            if self._front in ready:
                client, *frames = self._front.recv_multipart()
                if client not in self._backs:
                    back = self._backs[client] = self._context.socket(zmq.DEALER)
                    back.linger = 0
                    back.connect(self._service)
                    poller.register(back, zmq.POLLIN)
                self._meddle(client, True, frames)
            for client, back in self._backs.items():
                if back in ready:
                    self._meddle(client, False, back.recv_multipart())
            now_s = time.monotonic()
            due = [held for held in self._held if held.due_s <= now_s]
            self._held = [held for held in self._held if held.due_s > now_s]
            for held in due:
                self._send(held.client, held.to_service, held.frames)

    def _meddle(self, client: bytes, to_service: bool, frames: list[bytes]) -> None:
        if self._draw.random() >= self.share:
            self._send(client, to_service, frames)
            return
        fault = self._draw.choice(self.faults)
        self.done[fault] += 1
        if fault in ("delay", "reorder"):  # what comes later overtakes it
            wait_s = DELAY_S * (1.0 if fault == "delay" else self._draw.random())
            self._held.append(_Held(time.monotonic() + wait_s, client, to_service, frames))
        elif fault == "double":
            self._send(client, to_service, frames)
            self._send(client, to_service, frames)
        elif fault == "corrupt":
            place = self._draw.choice([i for i, frame in enumerate(frames) if frame])
            frame = bytearray(frames[place])
            frame[self._draw.randrange(len(frame))] ^= 1 << self._draw.randrange(8)
            self._send(client, to_service, [*frames[:place], bytes(frame), *frames[place + 1 :]])

    def _send(self, client: bytes, to_service: bool, frames: list[bytes]) -> None:
        with contextlib.suppress(zmq.Again):  # nobody has fetched anything for long: as good as dropped
            if to_service:
                self._backs[client].send_multipart(frames, flags=zmq.NOBLOCK)
            else:
                self._front.send_multipart([client, *frames], flags=zmq.NOBLOCK)
