"""Keeping a stack up: a process that ends is started again, after a pause that grows while it keeps ending."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable
from dataclasses import dataclass

from orchestrator.core.supervise import READY_TIMEOUT_S, Say, ServiceProcess, Stack
from shared.errors import UnavailableError


@dataclass(frozen=True)
class BackOff:
    """How long to wait before a process is started again.

    Attributes:
        first_s: after the first end; doubled with each further one.
        longest_s: never longer.
        calm_s: a process that ran for so long begins at `first_s` again.
    """

    first_s: float = 0.5
    longest_s: float = 30.0
    calm_s: float = 60.0

    def pause_s(self, ended: int) -> float:
        """The pause after the process has ended `ended` times in a row (1, 2, ...)."""
        # The exponent is bounded: a process that ends all week must not end in a number too large for a float.
        return min(self.first_s * 2.0 ** min(ended - 1, 32), self.longest_s)


@dataclass
class _Watch:
    """What is known of one process.

    Attributes:
        since_s: when it was started last.
        ended: how often it has ended in a row.
        due_s: when to start it again; None while it runs.
        starting: whether it was started and has not said yet that it is ready.
    """

    since_s: float
    ended: int = 0
    due_s: float | None = None
    starting: bool = False


class Keeper:
    """Looks after the processes of a stack that was started. Call `look` again and again; it never waits.

    Args:
        stack: what to keep up.
        say: told, for people, what ended and how, when it is started again, and that it is back.
        back_off: the pauses.
        ready_timeout_s: a process that is not ready after so long is ended and counts as one that ended.
        clock: seconds that only go forward.
    """

    def __init__(
        self,
        stack: Stack,
        say: Say,
        back_off: BackOff | None = None,
        ready_timeout_s: float = READY_TIMEOUT_S,
        clock: Callable[[], float] = time.monotonic,
    ):
        self._stack = stack
        self._say = say
        self._back_off = back_off or BackOff()
        self._ready_timeout_s = ready_timeout_s
        self._clock = clock
        self._watches = {process.name: _Watch(clock()) for process in stack.processes()}
        self.restarts = dict.fromkeys(self._watches, 0)
        """How often each was started again."""

    def look(self) -> None:
        """Notice what ended, start what is due, tell what is ready."""
        for process in self._stack.processes():
            watch = self._watches[process.name]
            if watch.due_s is not None:
                if self._clock() >= watch.due_s:
                    self._start(process.name, watch)
            elif not process.alive:
                self._ended(process.name, watch, how_it_ended(process.exit_code))
            elif watch.starting:
                self._listen(process, watch)
            elif watch.ended and self._clock() - watch.since_s >= self._back_off.calm_s:
                watch.ended = 0

    def _ended(self, name: str, watch: _Watch, how: str) -> None:
        # One that ran well for long is not to blame for ends of an hour ago, looked at in between or not.
        calm = not watch.starting and self._clock() - watch.since_s >= self._back_off.calm_s
        watch.ended = 1 if calm else watch.ended + 1
        watch.starting = False
        pause_s = self._back_off.pause_s(watch.ended)
        watch.due_s = self._clock() + pause_s
        again = "" if watch.ended == 1 else f" for the {_ordinal(watch.ended)} time in a row"
        self._say(f"{name} {how}{again}; it is started again in {pause_s:g} s")

    def _start(self, name: str, watch: _Watch) -> None:
        watch.due_s, watch.since_s, watch.starting = None, self._clock(), True
        self.restarts[name] += 1
        try:
            self._stack.restart(name)
        except OSError as error:  # no memory or no process left: whoever looks after the others goes on doing so
            self._ended(name, watch, f"could not be started ({error})")

    def _listen(self, process: ServiceProcess, watch: _Watch) -> None:
        try:
            address = process.hear()
        except UnavailableError:
            return  # it has ended in this moment, which the next look tells
        if address is not None:
            watch.starting = False
            self._say(f"{process.name}: {address} (pid {process.pid}) is back")
        elif self._clock() - watch.since_s > self._ready_timeout_s:
            process.stop()
            self._ended(process.name, watch, f"was not ready after {self._ready_timeout_s:g} s")


def how_it_ended(code: int | None) -> str:
    """An exit code in words: `ended with code 1`, `was killed by SIGKILL`."""
    if code is not None and code < 0:
        try:
            return f"was killed by {signal.Signals(-code).name}"
        except ValueError:
            return f"was killed by signal {-code}"
    return f"ended with code {code}"


def _ordinal(number: int) -> str:
    ending = "th" if 10 <= number % 100 <= 20 else {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th")
    return f"{number}{ending}"
