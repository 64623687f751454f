"""How long processes were ready to run and had no processor: what a machine under load adds to all that is measured."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

Waits = dict[tuple[int, int], float]


def waits(pids: Iterable[int]) -> Waits:
    """Seconds that each thread, by process and thread id, has waited for a processor since it began (Linux; elsewhere
    nothing is told)."""
    out: Waits = {}
    for pid in pids:
        for task in Path(f"/proc/{pid}/task").glob("*/schedstat"):
            try:
                _, waited_ns, _ = task.read_text().split()
            except (OSError, ValueError):
                continue  # the thread has ended
            out[pid, int(task.parent.name)] = int(waited_ns) / 1e9
    return out


def most_waited_s(before: Waits, after: Waits) -> float:
    """What the thread that waited most has waited between two looks."""
    return max((seconds - before.get(thread, 0.0) for thread, seconds in after.items()), default=0.0)
