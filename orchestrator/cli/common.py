"""What the commands share: console, errors for people, where the server is, provenance of numbers."""

from __future__ import annotations

import json
import os
import platform
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape

from orchestrator.client import Client
from shared.console import EXPECTED, as_ours, check_output_file, in_words

console = Console(stderr=True)

Url = Annotated[str, typer.Option(envvar="MOTIONLOOP_URL", help="server to talk to")]
Token = Annotated[str | None, typer.Option(envvar="MOTIONLOOP_TOKEN", help="bearer token of the server")]
HINTS = {
    "unauthorized": "give the server's token with --token or in MOTIONLOOP_TOKEN",
    "overloaded": "try again later, or end a character or an episode first",
    "incompatible_peer": "the old service stays in use; `motionloop conformance ENDPOINT` shows what does not fit",
}
"""What to do next, by error code; the messages of the others say it themselves."""


@contextmanager
def for_people() -> Iterator[None]:
    """Print what is expected to go wrong as one clear line and exit with 1."""
    try:
        yield
    except BrokenPipeError:
        raise
    except EXPECTED as error:
        code = as_ours(error).code
        hint = f"\n  {HINTS[code]}" if code in HINTS else ""
        line = escape(f"{in_words(error)}{hint}")
        console.print(f"[red]{line}[/red]", highlight=False, soft_wrap=True)
        raise typer.Exit(1) from error


def writable(path: Path | None) -> Path | None:
    """Callback of options that name a file to write: what is wrong with it is told before the work."""
    with for_people():
        check_output_file(path)
    return path


JsonFile = Annotated[Path | None, typer.Option("--json", help="write the result to this file", callback=writable)]


@contextmanager
def client(url: str, token: str | None) -> Iterator[Client]:
    """A client, with errors printed for people."""
    with for_people(), Client(url, token) as opened:
        yield opened


@contextmanager
def ending_on_sigterm() -> Iterator[None]:
    """Within it SIGTERM unwinds as Ctrl-C does, so that services end and temporary folders go; exit code 143."""

    def unwind(number: int, frame: object) -> None:
        raise SystemExit(128 + number)

    before = signal.signal(signal.SIGTERM, unwind)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def provenance(seed: int | None = None) -> dict[str, Any]:
    """What a number was made with and on."""
    return {
        "command": " ".join(["motionloop", *sys.argv[1:]]),
        "seed": seed,
        "commit": _commit(),
        "machine": {
            "cpu": _cpu(),
            "cores": os.cpu_count(),
            "python": platform.python_version(),
            "system": platform.platform(),
        },
    }


def write_json(path: Path | None, result: dict[str, Any]) -> None:
    """Write the result where it was asked for, and print it."""
    save_json(path, result)
    sys.stdout.write(json.dumps(result, indent=2) + "\n")


def save_json(path: Path | None, result: dict[str, Any]) -> None:
    """Write the result where it was asked for."""
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
        console.print(f"written: {path}", soft_wrap=True, highlight=False)


def _commit() -> str | None:
    here = Path(__file__).resolve().parent
    done = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], cwd=here, capture_output=True, text=True, check=False
    )  # fmt: skip
    return done.stdout.strip() or None


def _cpu() -> str:
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor()
