"""`python -m tests.chaos.kills`: the orchestrator is killed at random moments of running and ending episodes."""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import httpx
import numpy as np

from orchestrator.core.supervise import Stack
from tests.chaos.arena import Arena, wrong
from tests.orchestrator.support import kept_up, light

LONG = [{"type": "halt", "duration_s": 20}] * 30
SHORT = [{"type": "halt", "duration_s": 3}]
SPECS: tuple[dict[str, Any], ...] = (
    {"pacing": "realtime", "tracker": "kinematic", "tasks": LONG},
    {"pacing": "realtime", "tracker": "pd", "tasks": SHORT},
    {"pacing": "lockstep", "tracker": "kinematic", "tasks": LONG},
)


def kills(count: int, seed: int, data_dir: Path, most_s: float, say: Any = print) -> dict[str, Any]:
    """Kill it so often; what became of the episodes.

    Args:
        most_s: it is not killed again after so long.

    Returns:
        `behind_s`: how old the newest tick on the disk was when the kill came, of episodes by the clock;
        `going_s`: from the orchestrator's return until all episodes went on; `lost`, `not_finished` (told as finished
        before the kill, and not after it) and `wrong_recordings` must be empty.
    """
    began_s, draw = time.monotonic(), random.Random(seed)
    behind_s: list[float] = []
    going_s: list[float] = []
    not_finished: list[str] = []
    said: list[str] = []
    with Stack(light(data_dir)) as stack, httpx.Client(base_url=stack.url, timeout=30.0) as http:
        arena = Arena(http, specs=SPECS)
        with kept_up(stack, said.append):
            for number in range(count):
                if time.monotonic() - began_s > most_s:
                    break
                arena.wait(arena.going(), "episodes run")
                time.sleep(draw.uniform(0.0, 3.0))
                told = arena.look()
                finished = [end.id for end in arena.ended if end.status == "finished"]
                process = stack.orchestrator
                assert process is not None
                os.kill(process.pid, signal.SIGKILL)
                behind_s += [
                    (now["tick"] - _on_disk(data_dir, episode_id)) / 30.0
                    for episode_id, now in told.items()
                    if arena.running.get(episode_id, {}).get("pacing") == "realtime"
                ]
                arena.wait(lambda known=number: sum("orchestrator: " in line for line in said) > known, "it is back")
                going_s.append(arena.wait(arena.going(), "all go on"))
                for episode_id in finished[-5:]:
                    answer = arena.ask("GET", f"/v1/episodes/{episode_id}")
                    if answer is None or answer.json()["status"] != "finished":
                        not_finished.append(episode_id)
                say(json.dumps({"kill": number, "going_s": round(going_s[-1], 2), "finished": len(finished)}))
            arena.finish()
    return {
        "seed": seed,
        "kills": len(going_s),
        "behind_s": _spread(behind_s),
        "going_s": _spread(going_s),
        "episodes": {
            status: sum(end.status == status for end in arena.ended) for status in {end.status for end in arena.ended}
        },
        "lost": [end.id for end in arena.ended if end.status == "lost"],
        "not_finished": not_finished,
        "wrong_recordings": wrong(arena.ended),
    }


def _on_disk(data_dir: Path, episode_id: str) -> int:
    """The newest tick of an episode that its parts, or its one file, hold; -1 where nothing is there."""
    recordings = data_dir / "recordings"
    if (whole := recordings / f"{episode_id}.npz").exists():
        with np.load(whole, allow_pickle=False) as data:
            return len(data["body_pos_w_m"]) - 1
    ends = [
        int(start) + int(ticks) - 1
        for start, _, ticks in (file.stem.partition("-") for file in (recordings / f"{episode_id}.parts").glob("*.npz"))
    ]
    return max(ends, default=-1)


def _spread(values: list[float]) -> dict[str, float]:
    p50, p95 = np.percentile(values, [50, 95]) if values else (0.0, 0.0)
    return {"p50": round(float(p50), 2), "p95": round(float(p95), 2), "most": round(max(values, default=0.0), 2)}


def main() -> int:
    """Exit code 1 when an episode was lost, or a recording is not whole."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--json", type=Path, default=Path("out/kills.json"))
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="kills-") as folder:
        found = kills(given.kills, given.seed, Path(folder), 60.0 * given.minutes)
    given.json.parent.mkdir(parents=True, exist_ok=True)
    given.json.write_text(json.dumps(found, indent=1))
    print(json.dumps(found, indent=1))
    return int(any(found[name] for name in ("lost", "not_finished", "wrong_recordings")))


if __name__ == "__main__":
    sys.exit(main())
