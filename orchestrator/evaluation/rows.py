"""Rows of `eval tasks`, one an episode: which belong to the same measurement, and the file that outlives a kill."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

Row = dict[str, Any]
Key = tuple[str, int]
"""Task and number of the episode."""


@dataclass(frozen=True)
class Measured:
    """What is measured. Rows of anything else are not mixed in.

    Attributes:
        seed: of all episodes. variant: of the loop. planner, tracker: plug-ins; None for the services' own choice.
        varied: objects of other sizes (see `starts`). push_ns: how hard each task is disturbed (see `pushes`), N s.
        weights: version and weights of the planner and the tracker that answered.
    """

    seed: int = 1
    variant: str = "closed_loop"
    planner: str | None = None
    tracker: str | None = None
    varied: bool = False
    push_ns: float = 0.0
    weights: str | None = None

    def stamped(self, row: Row) -> Row:
        """A row that says what it is of."""
        return {**row, **asdict(self)}

    def owns(self, row: Row) -> bool:
        """Whether a row is of this measurement."""
        return all(row.get(name, 0.0 if name == "push_ns" else None) == value for name, value in asdict(self).items())


def finished(path: Path | None, measured: Measured) -> dict[Key, Row]:
    """Finished episodes of the same measurement. A line that a kill has cut off is taken out of the file."""
    if path is None or not path.exists():
        return {}
    text = path.read_text()
    whole = text[: text.rfind("\n") + 1]
    if whole != text:
        path.write_text(whole)
    rows = [json.loads(line) for line in whole.splitlines()]
    return {(row["task"], row["index"]): row for row in rows if measured.owns(row)}


def keep(path: Path | None, row: Row) -> None:
    """Add a row to the file."""
    if path is None:
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a") as file:
        file.write(json.dumps(row) + "\n")
