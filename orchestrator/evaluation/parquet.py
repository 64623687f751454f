"""Rows of episodes as Parquet (extra `parquet`): one a row, the same columns whatever was measured."""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from orchestrator.evaluation.rows import Row
from shared.errors import InvalidInputError

_TEXTS = ("task", "reason", "limb", "variant", "planner", "tracker", "weights")
_FLAGS = ("strict", "paper", "code", "fell", "varied")
_WHOLE = ("index", "seed", "plans", "octant")


def check_parquet() -> None:
    """Raises InvalidInputError where pyarrow is not installed."""
    if importlib.util.find_spec("pyarrow") is None:
        raise InvalidInputError("pyarrow is not installed; try: pip install 'motionloop[parquet]'", field="parquet")


def write_parquet(path: Path, rows: Sequence[Row]) -> None:
    """Write rows of `eval tasks`; `measures` is a map from names to numbers, `seconds` a float.

    Raises:
        InvalidInputError: pyarrow is not installed.
        OSError: the file cannot be written.
    """
    check_parquet()
    import pyarrow as arrow
    from pyarrow import parquet

    columns: list[tuple[str, Any]] = [
        *((name, arrow.string()) for name in _TEXTS),
        *((name, arrow.bool_()) for name in _FLAGS),
        *((name, arrow.int64()) for name in _WHOLE),
        ("seconds", arrow.float64()),
        ("push_ns", arrow.float64()),
        ("measures", arrow.map_(arrow.string(), arrow.float64())),
    ]
    flat = [{**row, "measures": list(row["measures"].items())} for row in rows]
    path.parent.mkdir(parents=True, exist_ok=True)
    parquet.write_table(arrow.Table.from_pylist(flat, schema=arrow.schema(columns)), path)
