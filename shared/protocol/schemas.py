"""JSON Schemas of all messages: `python -m shared.protocol.schemas docs/schemas` writes one file a message.

Array fields appear with `x-dtype` and `x-shape`; on the wire they are raw frames and no part of the JSON body.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from pydantic import BaseModel

from shared.protocol.arrays import array_specs
from shared.protocol.base import PROTOCOL_VERSION
from shared.protocol.control import Envelope
from shared.protocol.messages import MESSAGES


def schema_texts() -> dict[str, str]:
    """File name -> content of every schema file."""
    models: dict[str, type[BaseModel]] = {"Envelope": Envelope, **MESSAGES}
    return {f"{name}.json": _schema(name, model) for name, model in models.items()}


def write_schemas(folder: Path) -> None:
    """Make the folder's schema files current; files of messages that are gone are deleted."""
    folder.mkdir(parents=True, exist_ok=True)
    texts = schema_texts()
    for path in folder.glob("*.json"):
        if path.name not in texts:
            path.unlink()
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")


def _schema(name: str, model: type[BaseModel]) -> str:
    schema = model.model_json_schema()
    schema = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": f"motionloop/v{PROTOCOL_VERSION}/{name}",
        **schema,
    }
    arrays = list(array_specs(model))
    if arrays:
        schema["x-array-frames"] = arrays
    return json.dumps(schema, indent=2, sort_keys=True) + "\n"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description="Write the JSON Schemas of all messages.")
    parser.add_argument("folder", type=Path)
    write_schemas(parser.parse_args().folder)


if __name__ == "__main__":
    main()
