"""A proxy for one client of a service that drops, delays, doubles, reorders and corrupts messages, by a seed."""

from __future__ import annotations

import random
import threading
import time
from collections import Counter
from typing import Any

import zmq

FAULTS = ("drop", "delay", "double", "reorder", "corrupt")
DELAY_S = 0.15


class ChaosProxy:
    """Stands before a service, at `endpoint`; a context manager.

    Args:
        service: the endpoint of the service.
        seed: decides which messages are meddled with, and how.
        share: of the messages, either way, that have something done to them.
    """

    def __init__(self, service: str, seed: int, share: float):
        self._draw = random.Random(seed)
        self._share = share
        self._context: zmq.Context[Any] = zmq.Context()
        self._front = self._context.socket(zmq.ROUTER)
        self._back = self._context.socket(zmq.DEALER)
        self._front.linger = self._back.linger = 0
        self._front.bind("tcp://127.0.0.1:*")
        self.endpoint = self._front.getsockopt(zmq.LAST_ENDPOINT).decode().rstrip("\0")
        self._back.connect(service)
        self.done: Counter[str] = Counter()
        self._held: list[tuple[float, bool, list[bytes]]] = []
        self._client: bytes | None = None
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="chaos", daemon=True)

    def __enter__(self) -> ChaosProxy:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        self._thread.join()
        self._context.destroy(linger=0)

    def _run(self) -> None:
        poller = zmq.Poller()
        for socket in (self._front, self._back):
            poller.register(socket, zmq.POLLIN)
        while not self._ending.is_set():
            ready = dict(poller.poll(10))
            if self._front in ready:
                self._client, *frames = self._front.recv_multipart()
                self._meddle(True, frames)
            if self._back in ready:
                self._meddle(False, self._back.recv_multipart())
            now_s = time.monotonic()
            due = [held for held in self._held if held[0] <= now_s]
            self._held = [held for held in self._held if held[0] > now_s]
            for _, to_service, frames in due:
                self._send(to_service, frames)

    def _meddle(self, to_service: bool, frames: list[bytes]) -> None:
        if self._draw.random() >= self._share:
            self._send(to_service, frames)
            return
        fault = self._draw.choice(FAULTS)
        self.done[fault] += 1
        if fault in ("delay", "reorder"):  # what comes later overtakes it
            wait_s = DELAY_S * (1.0 if fault == "delay" else self._draw.random())
            self._held.append((time.monotonic() + wait_s, to_service, frames))
        elif fault == "double":
            self._send(to_service, frames)
            self._send(to_service, frames)
        elif fault == "corrupt":
            place = self._draw.choice([i for i, frame in enumerate(frames) if frame])
            frame = bytearray(frames[place])
            frame[self._draw.randrange(len(frame))] ^= 1 << self._draw.randrange(8)
            self._send(to_service, [*frames[:place], bytes(frame), *frames[place + 1 :]])

    def _send(self, to_service: bool, frames: list[bytes]) -> None:
        if to_service:
            self._back.send_multipart(frames)
        elif self._client is not None:
            self._front.send_multipart([self._client, *frames])
