"""Pauses of Python's garbage collector, kept short in services that answer by the clock."""

from __future__ import annotations

import gc


def spare_what_stays() -> None:
    """Call when a service is ready: what it is made of stays until it ends, and is not gone through again.

    Without it each collection of the oldest generation goes through all modules, routes and weights: 70 to 95 ms in
    the orchestrator, every few seconds under load (`docs/reliability.md`).
    """
    gc.collect()
    gc.freeze()
