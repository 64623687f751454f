"""Commands that belong to a service's own training package: run as modules, with their own options."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from collections.abc import Sequence
from typing import Any

import typer

from orchestrator.cli.common import console, ending_on_sigterm

TERMINATED = 143
PASS_THROUGH = {"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []}
"""Typer context in which every option goes through to the module."""


def run_module(module: str, arguments: Sequence[str]) -> None:
    """`python -m module arguments`; exits with its code."""
    _check_installed(module)
    raise typer.Exit(run_quietly(module, arguments))


def run_quietly(module: str, arguments: Sequence[str]) -> int:
    """The exit code of `python -m module arguments`; 130 after Ctrl-C, 143 after SIGTERM.

    The module is in a process group of its own: Ctrl-C reaches it as the SIGTERM that it ends cleanly on, and not as an
    exception in the middle of its imports. Neither leaves it behind.
    """
    with ending_on_sigterm():
        process = subprocess.Popen([sys.executable, "-m", module, *arguments], process_group=0)
        try:
            return process.wait()
        except BaseException as told:
            process.terminate()
            process.wait()
            if isinstance(told, KeyboardInterrupt | SystemExit):
                return 130 if isinstance(told, KeyboardInterrupt) else TERMINATED
            raise


def module_json(module: str, arguments: Sequence[str]) -> dict[str, Any]:
    """What `python -m module arguments` prints, a JSON object; exits with its code where it fails."""
    _check_installed(module)
    done = subprocess.run([sys.executable, "-m", module, *arguments], check=False, stdout=subprocess.PIPE, text=True)
    if done.returncode:
        raise typer.Exit(done.returncode)
    return dict(json.loads(done.stdout))


def need(*modules: str) -> None:
    """Exit with code 2 and say what to install, where one of the modules is missing."""
    for module in modules:
        if importlib.util.find_spec(module) is None:
            say_what_is_missing(module)


def say_what_is_missing(module: str) -> None:
    """Say what to install, and exit with code 2."""
    console.print(f"[red]{module} is not installed[/red]; try: pip install 'motionloop\\[all]'")
    raise typer.Exit(2)


def _check_installed(module: str) -> None:
    need(module.partition(".")[0], module)
