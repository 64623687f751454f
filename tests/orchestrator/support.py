"""What the tests of this folder share: a stack that starts quickly, and an episode played to its end."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import numpy as np

from orchestrator.core.supervise import StackOptions

LIGHT = StackOptions(planner_plugin="stand", tracker_plugin="kinematic", planner_args=("--plugins", "stand"))
"""Without torch a planner is there in a second."""


def light(data_dir: Path, library: Path | None = None) -> StackOptions:
    """Options for `stand` and `kinematic`; with a library `clip` is offered too."""
    options = replace(LIGHT, data_dir=str(data_dir))
    if library is None:
        return options
    return replace(options, planner_args=("--plugins", "stand,clip", "--clip-library", str(library)))


def play(http: httpx.Client, spec: dict[str, Any]) -> tuple[dict[str, Any], dict[str, bytes]]:
    """Run an episode to its end; what became of it, and every array of its recording as bytes."""
    reply = http.post("/v1/episodes", json=spec)
    assert reply.status_code == 201, reply.text
    path = f"/v1/episodes/{reply.json()['id']}"
    # The stream of events ends with the episode.
    assert '"type":"end"' in http.get(f"{path}/events").text.replace(" ", "")
    with np.load(io.BytesIO(http.get(f"{path}/motion.npz").content), allow_pickle=False) as data:
        recording = {name: data[name].tobytes() for name in data.files}
    return http.get(path).json(), recording
