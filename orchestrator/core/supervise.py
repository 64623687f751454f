"""Starting the services as processes, knowing when they are ready, and ending them all without leaving one behind."""

from __future__ import annotations

import ctypes
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType

from shared.errors import UnavailableError

READY_TIMEOUT_S = 120.0
STOP_TIMEOUT_S = 8.0
_PR_SET_PDEATHSIG = 1
_FREE = "tcp://127.0.0.1:0"
_PLANNER_NICENESS, _ORCHESTRATOR_NICENESS = 5, 10
"""Characters by the clock come first, plans next, and those who ask for more than can be done last."""
_ONE_THREAD = {name: "1" for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")}

Say = Callable[[str], None]


def _die_with_parent() -> None:
    """In the child: be ended by the kernel when the parent is killed (Linux; elsewhere the process group must do)."""
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def _give_way(niceness: int) -> None:
    """In the child: let others have the processors first, by setpriority(2).

    Where the kernel shares them among sessions before it does among threads (sched(7), autogroups), the session gives
    way too; without that a process of a session of its own is as nice as any other.
    """
    os.nice(niceness)
    with suppress(OSError):  # there is none, or it may not be written
        Path("/proc/self/autogroup").write_text(str(niceness), encoding="ascii")


@dataclass
class ServiceProcess:
    """A service in a process of its own session.

    Attributes:
        name: for people.
        command: argument list.
        environment: added to the parent's.
        niceness: 0 to 19, added to the parent's: how far it gives way to other processes.
    """

    name: str
    command: Sequence[str]
    environment: dict[str, str] = field(default_factory=dict)
    niceness: int = 0

    def __post_init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None
        self._lines: queue.Queue[str | None] = queue.Queue()
        self.address = ""

    @property
    def pid(self) -> int:
        """Process id; 0 before the start."""
        return 0 if self._process is None else self._process.pid

    @property
    def alive(self) -> bool:
        """Whether it runs."""
        return self._process is not None and self._process.poll() is None

    @property
    def exit_code(self) -> int | None:
        """None while it runs."""
        return None if self._process is None else self._process.poll()

    def start(self) -> None:
        """Start it; `wait_ready` tells when it serves."""
        self._process = subprocess.Popen(
            list(self.command),
            stdout=subprocess.PIPE,
            stdin=subprocess.DEVNULL,
            text=True,
            env={**os.environ, **self.environment, "PYTHONUNBUFFERED": "1"},
            start_new_session=True,
            preexec_fn=self._prepare,
        )
        threading.Thread(target=self._read, args=(self._process,), name=f"{self.name}-output", daemon=True).start()

    def _prepare(self) -> None:
        _die_with_parent()
        if self.niceness:
            _give_way(self.niceness)

    def _read(self, process: subprocess.Popen[str]) -> None:
        stream = process.stdout
        if stream is not None:
            for line in stream:
                self._lines.put(line.rstrip())
            stream.close()
        self._lines.put(None)

    def wait_ready(self, timeout_s: float = READY_TIMEOUT_S) -> str:
        """Wait for the line that says `ready` and ends in an address; returns the address.

        Raises UnavailableError when the process ends first or says nothing in time.
        """
        until = time.monotonic() + timeout_s
        said: list[str] = []
        while True:
            try:
                line = self._lines.get(timeout=max(until - time.monotonic(), 0.0))
            except queue.Empty:
                raise UnavailableError(f"the {self.name} was not ready after {timeout_s:.0f} s") from None
            if line is None:
                code = self._process.wait() if self._process is not None else None
                last = " | ".join(said[-5:])
                raise UnavailableError(f"the {self.name} ended with code {code} while starting; {last}")
            said.append(line)
            address = address_in(line)
            if address is not None:
                self.address = address
                return address

    def hear(self) -> str | None:
        """Like `wait_ready`, at once: the address if the process has said by now that it is ready, else None.

        Raises UnavailableError when the process has ended first.
        """
        try:
            return self.wait_ready(0.0)
        except UnavailableError:
            if self.alive:
                return None
            raise

    def ask_to_end(self) -> None:
        """SIGTERM, without waiting."""
        if self._process is not None and self._process.poll() is None:
            self._process.terminate()

    def stop(self, timeout_s: float = STOP_TIMEOUT_S) -> None:
        """SIGTERM, then SIGKILL for the whole session of the process. Safe to call twice."""
        process = self._process
        if process is None:
            return
        if process.poll() is None:
            process.terminate()
            try:
                process.wait(timeout_s)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        try:
            os.killpg(process.pid, signal.SIGKILL)  # children of its own that outlived it
        except (ProcessLookupError, PermissionError):
            return


def address_in(line: str) -> str | None:
    """The first address in a line that speaks of being ready."""
    if "ready" not in line.lower():
        return None
    for word in line.replace(",", " ").replace(";", " ").split():
        _, _, value = word.rpartition("=")
        if value.startswith(("tcp://", "ipc://", "http://")):
            return value
    return None


@dataclass(frozen=True)
class StackOptions:
    """What the three processes are started with.

    Attributes:
        host, port: of the HTTP server; port 0 takes a free one.
        planner_plugin, tracker_plugin: plug-ins to use; None for the services' defaults.
        scenes: folder of scenes of one's own.
        planner_args, tracker_args, orchestrator_args: more arguments.
    """

    host: str = "127.0.0.1"
    port: int = 0
    planner_plugin: str | None = None
    tracker_plugin: str | None = None
    data_dir: str | None = None
    scenes: str | None = None
    planner_args: tuple[str, ...] = ()
    tracker_args: tuple[str, ...] = ()
    orchestrator_args: tuple[str, ...] = ()


class Stack:
    """Planner, tracker and orchestrator as three processes; a context manager that leaves none behind.

    Args:
        options: how to start them.
        say: told what happens, for people.
    """

    def __init__(self, options: StackOptions | None = None, say: Say | None = None):
        self.options = options or StackOptions()
        self._say = say or (lambda line: None)
        self.planner = self._planner(_FREE)
        self.tracker = self._tracker(_FREE)
        self.orchestrator: ServiceProcess | None = None
        self.url = ""

    def start_services(self, timeout_s: float = READY_TIMEOUT_S) -> tuple[str, str]:
        """Start planner and tracker only; returns their endpoints."""
        for process in (self.planner, self.tracker):
            process.start()
        for process in (self.planner, self.tracker):
            self._say(f"{process.name}: {process.wait_ready(timeout_s)} (pid {process.pid})")
        return self.planner.address, self.tracker.address

    def start(self, timeout_s: float = READY_TIMEOUT_S) -> str:
        """Start all three; returns the URL. Ends what was started when one fails."""
        try:
            planner, tracker = self.start_services(timeout_s)
            self.orchestrator = self._orchestrator(planner, tracker, self.options.port)
            self.orchestrator.start()
            self.url = self.orchestrator.wait_ready(timeout_s)
            self._say(f"orchestrator: {self.url} (pid {self.orchestrator.pid})")
        except BaseException:
            self.stop()
            raise
        return self.url

    def dead(self) -> list[str]:
        """Names of processes that were started and have ended."""
        return [p.name for p in self.processes() if p.pid and not p.alive]

    def restart(self, name: str) -> ServiceProcess:
        """Start a process that has ended again, where it listened before, so that the others find it; not yet ready.

        Raises:
            KeyError: nothing of this name was ready before.
        """
        old = {p.name: p for p in self.processes() if p.address}[name]
        old.stop()
        if old is self.planner:
            new = self.planner = self._planner(old.address)
        elif old is self.tracker:
            new = self.tracker = self._tracker(old.address)
        else:
            port = int(old.address.rpartition(":")[2])
            new = self.orchestrator = self._orchestrator(self.planner.address, self.tracker.address, port)
        new.address = old.address
        new.start()
        return new

    def stop(self) -> None:
        """End all: the orchestrator first, then the services together. Safe to call twice."""
        if self.orchestrator is not None:
            self.orchestrator.stop()
        for process in self.processes():
            process.ask_to_end()
        for process in self.processes():
            process.stop()

    def __enter__(self) -> Stack:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def processes(self) -> list[ServiceProcess]:
        """Those there are: the orchestrator, once it was started, planner and tracker."""
        return [p for p in (self.orchestrator, self.planner, self.tracker) if p is not None]

    def _planner(self, endpoint: str) -> ServiceProcess:
        command = [sys.executable, "-m", "planner_service", "--endpoint", endpoint, *self.options.planner_args]
        return ServiceProcess("planner", command, _ONE_THREAD, _PLANNER_NICENESS)

    def _tracker(self, endpoint: str) -> ServiceProcess:
        command = [sys.executable, "-m", "tracker_service", "--endpoint", endpoint, *self.options.tracker_args]
        return ServiceProcess("tracker", command, _ONE_THREAD)

    def _orchestrator(self, planner: str, tracker: str, port: int) -> ServiceProcess:
        options = self.options
        command = [
            sys.executable, "-m", "orchestrator", "--planner", planner, "--tracker", tracker,
            "--host", options.host, "--port", str(port), *options.orchestrator_args,
        ]  # fmt: skip
        for flag, value in (
            ("--planner-plugin", options.planner_plugin),
            ("--tracker-plugin", options.tracker_plugin),
            ("--data-dir", options.data_dir),
            ("--scenes", options.scenes),
        ):
            command += [] if value is None else [flag, value]
        return ServiceProcess("orchestrator", command, _ONE_THREAD, _ORCHESTRATOR_NICENESS)
