"""How many characters a machine bears: doubled while it keeps up, then halved."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from orchestrator.evaluation.bench import MISSED_SHARE, most_characters


@pytest.mark.parametrize(
    ("bears", "tried"),
    [
        (0, [1]),
        (1, [1, 2]),
        (5, [1, 2, 4, 5, 6, 8]),
        (8, [1, 2, 4, 8, 9, 10, 12, 16]),
        (20, [1, 2, 4, 8, 16, 18, 19, 20]),
    ],
)
@pytest.mark.parametrize("late", [True, False])
def test_the_most_that_keep_up_are_found(bears: int, tried: list[int], late: bool) -> None:
    asked: list[int] = []

    async def bench(characters: int) -> dict[str, Any]:
        asked.append(characters)
        over = characters > bears
        missed = MISSED_SHARE if over and not late else 0.0
        return {"characters": characters, "missed_share": missed, "late_plans": int(over and late)}

    found = asyncio.run(most_characters(bench, 20))
    assert found["max_characters"] == bears
    assert sorted(asked) == tried == [row["characters"] for row in found["rows"]]
