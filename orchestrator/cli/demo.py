"""`motionloop demo`: the three services, one episode over HTTP, and what it leaves in out/demo."""

from __future__ import annotations

import json
import tempfile
import time
from pathlib import Path
from typing import Any

from rich.console import Console

from orchestrator.cli.common import ending_on_sigterm, provenance
from orchestrator.cli.show import follow, table
from orchestrator.client import EpisodeInfo, MotionLoopClient
from orchestrator.core.supervise import Stack, StackOptions
from shared.errors import MotionLoopError

TASKS: list[dict[str, Any]] = [
    {"type": "reach", "name": "walk to a point", "relative_m": [2.0, 0.6]},
    {"type": "text", "name": "wave", "text": "a person waves with the right hand.", "duration_s": 5.0},
    {"type": "reach", "name": "walk to a point behind", "relative_m": [-2.0, -0.3]},
    {"type": "halt", "name": "stand still"},
]


def run_demo(
    out: Path, seed: int, planner: str | None, tracker: str | None, pacing: str, console: Console, film: bool = True
) -> bool:
    """Start the three services and run the demo; True when every task succeeded strictly. Leaves no process behind."""
    with ending_on_sigterm(), tempfile.TemporaryDirectory(prefix="motionloop-demo-") as data_dir:
        options = StackOptions(planner_plugin=planner, tracker_plugin=tracker, data_dir=data_dir)
        with Stack(options, console.print) as stack, MotionLoopClient(stack.url) as client:
            return play_demo(client, out, seed, pacing, console, film)


def play_demo(client: MotionLoopClient, out: Path, seed: int, pacing: str, console: Console, film: bool = True) -> bool:
    """Run the demo on services that are there already; True when every task succeeded strictly."""
    out.mkdir(parents=True, exist_ok=True)
    began = time.monotonic()
    services = client.services()
    used = ", ".join(f"{kind} {services[kind]['plugin']}" for kind in ("planner", "tracker"))
    console.print(f"running with {used}; seed {seed}")
    episode_id = client.start_episode({"tasks": TASKS, "seed": seed, "pacing": pacing, "name": "demo"})
    follow(client.events(episode_id), console)
    episode = client.episode(episode_id)
    console.print(table(episode))
    _keep(out / "episode.npz", client.motion(episode_id, "npz"), console)
    _keep(out / "episode.bvh", client.motion(episode_id, "bvh"), console)
    result = _result(episode, services, seed, time.monotonic() - began)
    _keep(out / "result.json", (json.dumps(result, indent=2) + "\n").encode(), console)
    if film:  # last, since it takes longest: whoever does not wait for it has the rest
        _film(client, episode_id, out, console)
    return bool(episode.success)


def _film(client: MotionLoopClient, episode_id: str, out: Path, console: Console) -> None:
    try:
        with console.status("rendering the video ..."):
            video = client.video(episode_id)
    except MotionLoopError as error:
        console.print(f"[yellow]no video: {error.message}[/yellow]")
        return
    _keep(out / "video.mp4", video, console)
    notes = [e.data for e in client.events(episode_id) if e.type == "video"]
    for note in notes:
        if note.get("note"):
            console.print(f"video renderer {note['renderer']}: {note['note']}")


def _keep(path: Path, data: bytes, console: Console) -> None:
    path.write_bytes(data)
    console.print(f"written: {path} ({len(data) / 1024:.0f} KiB)", highlight=False)


def _result(episode: EpisodeInfo, services: dict[str, Any], seed: int, wall_s: float) -> dict[str, Any]:
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
        "services": {kind: services[kind]["spec"] for kind in ("planner", "tracker")},
        "simulated_s": round((episode.tick or 0) / 30, 2),
        "wall_s": round(wall_s, 1),
        **provenance(seed),
    }
