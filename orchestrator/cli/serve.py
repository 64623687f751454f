"""`motionloop serve`: one service, or all three under supervision."""

from __future__ import annotations

import signal
import time
from pathlib import Path
from types import FrameType

from rich.console import Console

from orchestrator.api.listener import check_port
from orchestrator.cli.delegate import TERMINATED, run_quietly
from orchestrator.core.keeper import Keeper
from orchestrator.core.supervise import Stack, StackOptions
from orchestrator.store.lock import check_free

MODULES = {"planner": "planner_service", "tracker": "tracker_service", "orchestrator": "orchestrator"}
LOOK_S = 0.2


class _Stop(Exception):
    """A signal asks to end."""


def _stop(signum: int, frame: FrameType | None) -> None:
    raise _Stop


def serve_one(name: str, arguments: list[str]) -> int:
    """Run one service in this terminal, with its own arguments. A signal ends it too: exit code 0 then."""
    return 0 if (code := run_quietly(MODULES[name], arguments)) in (130, TERMINATED) else code


def serve_all(options: StackOptions, console: Console) -> int:
    """Run all three until SIGTERM or Ctrl-C; one that ends is started again. None is left behind. Exit code 0.

    Raises:
        ConflictError: the port or the data folder is taken; nothing was started then.
    """
    check_port(options.host, options.port)
    if options.data_dir is not None:
        check_free(Path(options.data_dir))
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, _stop)
    stack = Stack(options, console.print)
    try:
        url = stack.start()
        console.print(f"[bold]{url}[/bold]  API: {url}/docs  (Ctrl-C ends all)")
        keeper = Keeper(stack, console.print)
        while True:
            time.sleep(LOOK_S)
            keeper.look()
    except _Stop:
        return 0
    finally:
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, signal.SIG_IGN)
        stack.stop()
