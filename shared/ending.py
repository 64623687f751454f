"""Ending a service's process when it is told to (SIGTERM, Ctrl-C), whatever it is at.

Python runs signal handlers in the main thread, between two of its own instructions: not while that is in a library's
call that lasts. So what lasts happens in other threads, and the main thread only waits.
"""

from __future__ import annotations

import logging
import os
import queue
import signal
import sys
import threading
from collections.abc import Callable
from concurrent.futures import Future
from types import FrameType
from typing import NoReturn, TypeVar

T = TypeVar("T")
GRACE_S = 4.0
"""Less than the five seconds after which `docker compose` kills."""


class Ending:
    """Takes the signals from when it is made, in the main thread and before anything heavy is imported: the first
    process of a container would not be ended by them otherwise.

    Until `serve` a signal ends the process at once, with exit code 0: nothing is lost that early. After it the signal
    ends `wait`, and the process has `grace_s` to finish what it is at.

    Args:
        grace_s: after so long the process ends with exit code 0, finished or not.
    """

    def __init__(self, grace_s: float = GRACE_S):
        self._grace_s = grace_s
        self._serving = False
        # Unlike an Event's, its `put` may interrupt its own `get`, as a signal does.
        self._asked: queue.SimpleQueue[None] = queue.SimpleQueue()
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._take)

    def start(self, make: Callable[[], T]) -> T:
        """What `make` gives or raises; it may take long, also within libraries."""
        future: Future[T] = Future()

        def run() -> None:
            try:
                future.set_result(make())
            except BaseException as error:  # noqa: BLE001 - raised where it is waited for
                future.set_exception(error)

        threading.Thread(target=run, name="start", daemon=True).start()
        return future.result()

    def serve(self) -> None:
        """From now on there is something to finish."""
        self._serving = True

    def wait(self) -> None:
        """Until a signal asks to end."""
        self._asked.get()

    def leave(self, code: int) -> NoReturn:
        """End the process now. What torch or OpenVINO have loaded takes seconds to be taken down in the usual way."""
        logging.shutdown()
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        os._exit(code)

    def _take(self, number: int, frame: FrameType | None) -> None:
        if not self._serving:
            os._exit(0)
        grace = threading.Timer(self._grace_s, os._exit, (0,))
        grace.daemon = True
        grace.start()
        self._asked.put(None)
