"""OpenVINO with two of its habits left out; import it from here.

Importing `openvino` tells an analytics server so, unasked: `openvino_telemetry` is kept from being found.

On a processor with AMX its CPU plug-in gives the main thread another signal stack, and when it is taken down puts
back the one it had found, which by then may belong to a plug-in that is gone: the next signal that Python handles is a
segmentation fault. So there is one core a process, and it is never taken down.
"""

from __future__ import annotations

import importlib
import sys
from functools import cache
from typing import Any

sys.modules.setdefault("openvino_telemetry", None)  # type: ignore[arg-type]
openvino = importlib.import_module("openvino")
ops = importlib.import_module("openvino.opset13")


@cache
def core() -> Any:
    """The `openvino.Core` of this process."""
    return openvino.Core()
