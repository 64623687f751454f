"""`motionloop demo`: the three services, one episode over HTTP, and what it leaves in out/demo."""

from __future__ import annotations

import json
import tempfile
import time
from pathlib import Path
from typing import Any

from rich.console import Console

from orchestrator.cli.common import ending_on_sigterm, provenance
from orchestrator.cli.show import Follower, table
from orchestrator.client import Client, Episode, EpisodeInfo, ServicesInfo
from orchestrator.client.calls import Format
from orchestrator.core.supervise import Stack, StackOptions
from shared.errors import MotionLoopError
from shared.protocol.messages import Pacing
from shared.protocol.rates import TICK_HZ

TASKS: list[dict[str, Any]] = [
    {"type": "reach", "name": "walk towards the bag", "position_m": [1.0, 0.2]},
    {"type": "strike", "name": "strike the bag", "limb": "right_hand", "retries": 4},
    {"type": "sit", "name": "sit on the sofa", "retries": 3},
    {"type": "get_up", "name": "get up", "retries": 2},
    {"type": "text", "name": "wave", "text": "a person waves with the right hand.", "duration_s": 5.0, "retries": 1},
]
EPISODE: dict[str, Any] = {"name": "demo", "scene": "room", "tasks": TASKS}
"""What is shown unless another episode is asked for."""
KEPT: tuple[Format, ...] = ("npz", "bvh", "glb")


def run_demo(
    out: Path,
    seed: int,
    planner: str | None,
    tracker: str | None,
    pacing: Pacing,
    console: Console,
    film: bool = True,
    episode: dict[str, Any] | None = None,
) -> bool:
    """Start the three services and run the demo; True when every task succeeded strictly. Leaves no process behind."""
    out.mkdir(parents=True, exist_ok=True)  # before the services start: what cannot be made is told at once
    with ending_on_sigterm(), tempfile.TemporaryDirectory(prefix="motionloop-demo-") as data_dir:
        options = StackOptions(planner_plugin=planner, tracker_plugin=tracker, data_dir=data_dir)
        with Stack(options, console.print) as stack, Client(stack.url) as client:
            return play_demo(client, out, seed, pacing, console, film, episode)


def play_demo(
    client: Client,
    out: Path,
    seed: int,
    pacing: Pacing,
    console: Console,
    film: bool = True,
    episode: dict[str, Any] | None = None,
) -> bool:
    """Run the demo, or another episode as POST /v1/episodes takes it, on services that are there already; True when
    every task succeeded strictly."""
    out.mkdir(parents=True, exist_ok=True)
    began = time.monotonic()
    services = client.services()
    console.print(f"running with planner {services.planner.plugin}, tracker {services.tracker.plugin}; seed {seed}")
    spec = {**(episode or EPISODE), "seed": seed, "pacing": pacing}
    run = client.episode(spec.pop("tasks", []), **spec)
    with Follower(console) as follower:
        shown = run.wait(on_event=follower.take)
    console.print(table(shown))
    for kind in KEPT:
        _keep(out / f"episode.{kind}", run.export(kind), console)
    result = _result(shown, services, seed, time.monotonic() - began)
    _keep(out / "result.json", (json.dumps(result, indent=2) + "\n").encode(), console)
    if film:  # last, since it takes longest: whoever does not wait for it has the rest
        _film(run, out, console)
    return bool(shown.success)


def _film(run: Episode, out: Path, console: Console) -> None:
    try:
        with console.status("rendering the video ..."):
            video = run.export("mp4")
    except MotionLoopError as error:
        console.print(f"[yellow]no video: {error.message}[/yellow]")
        return
    _keep(out / "video.mp4", video, console)
    for note in (event.data for event in run.events() if event.type == "video"):
        if note.get("note"):
            console.print(f"video renderer {note['renderer']}: {note['note']}")


def _keep(path: Path, data: bytes, console: Console) -> None:
    path.write_bytes(data)
    console.print(f"written: {path} ({len(data) / 1024:.0f} KiB)", highlight=False)


def _result(episode: EpisodeInfo, services: ServicesInfo, seed: int, wall_s: float) -> dict[str, Any]:
    return {
        "success": bool(episode.success),
        "status": episode.status,
        "reason": episode.reason,
        "tasks": [
            {
                "name": task.name,
                "success_strict": task.success_strict,
                "seconds": task.seconds,
                "fell": task.fell,
                "reason": task.reason,
                "measures": task.measures,
            }
            for task in episode.results
        ],
        "services": {"planner": services.planner.spec, "tracker": services.tracker.spec},
        "simulated_s": round((episode.tick or 0) / TICK_HZ, 2),
        "wall_s": round(wall_s, 1),
        **provenance(seed),
    }
