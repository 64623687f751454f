"""How many updates a second each of several viewers of one realtime character gets.

    python benchmarks/page_viewers.py --viewers 3 --seconds 20 --json out/bench_page_viewers.json

A viewer does what the page does: the binary stream, every state acknowledged (orchestrator/api/stream.py). The
character walks all the time. Planner and tracker are the trained ones unless others are named.
"""

from __future__ import annotations

import argparse
import asyncio
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from websockets.asyncio.client import connect

from orchestrator.api.binary import unpack
from orchestrator.cli.common import provenance, write_json
from orchestrator.core.supervise import Stack, StackOptions

SETTLE_S = 3.0
COMMAND = {"velocity_mps": [0.6, 0.0], "text": "a person is walking."}


async def watch(url: str, until_s: float) -> dict[str, Any]:
    """States of one viewer until a time of the monotonic clock."""
    arrivals, ticks = [], []
    async with connect(url) as socket:
        while (left := until_s - time.monotonic()) > 0:
            try:
                message = await asyncio.wait_for(socket.recv(), left)
            except TimeoutError:
                break
            if isinstance(message, str):
                continue
            header, _ = unpack(message)
            if header["type"] != "state":
                continue
            await socket.send(str(header["tick"]))
            arrivals.append(time.monotonic())
            ticks.append(header["tick"])
    gaps_ms = np.diff(arrivals) * 1e3
    seconds = arrivals[-1] - arrivals[0]
    return {
        "updates_per_s": round((len(arrivals) - 1) / seconds, 2),
        "fresh_ticks_per_s": round((len(set(ticks)) - 1) / seconds, 2),
        "gap_ms": {"p50": round(float(np.median(gaps_ms)), 1), "p99": round(float(np.percentile(gaps_ms, 99)), 1)},
    }


async def measure(url: str, viewers: int, seconds: float, seed: int) -> dict[str, Any]:
    """Make a character, let it walk, watch it."""
    async with httpx.AsyncClient(base_url=url, timeout=60.0) as http:
        made = await http.post("/v1/characters", json={"pacing": "realtime", "seed": seed})
        made.raise_for_status()
        character = made.json()["id"]
        (await http.post(f"/v1/characters/{character}/commands", json=COMMAND)).raise_for_status()
        await asyncio.sleep(SETTLE_S)
        stream = url.replace("http", "ws") + f"/v1/characters/{character}/stream?format=binary&tail=0"
        until_s = time.monotonic() + seconds
        found = await asyncio.gather(*(watch(stream, until_s) for _ in range(viewers)))
        body = (await http.get(f"/v1/characters/{character}")).json()
        services = (await http.get("/v1/services")).json()
        await http.delete(f"/v1/characters/{character}")
    return {
        "viewers": list(found),
        "slowest_updates_per_s": min(viewer["updates_per_s"] for viewer in found),
        "seconds": seconds,
        "plans": body["plans"],
        "missed_ticks": body["state"]["missed_ticks"],
        "planner": services["planner"]["plugin"],
        "tracker": services["tracker"]["plugin"],
    }


def main() -> int:
    """Exit code 1 when a viewer got fewer than 25 updates a second."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--viewers", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--planner", default=None, help="planner plug-in")
    parser.add_argument("--tracker", default=None, help="tracker plug-in")
    parser.add_argument("--json", type=Path, default=None, help="write the result to this file")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        options = StackOptions(
            planner_plugin=arguments.planner, tracker_plugin=arguments.tracker, data_dir=str(Path(folder) / "data")
        )
        with Stack(options, lambda line: sys.stderr.write(f"{line}\n")) as stack:
            result = asyncio.run(measure(stack.url, arguments.viewers, arguments.seconds, arguments.seed))
    command = " ".join(["python", "benchmarks/page_viewers.py", *sys.argv[1:]])
    write_json(arguments.json, {**result, **provenance(arguments.seed), "command": command})
    return 0 if result["slowest_updates_per_s"] >= 25.0 else 1


if __name__ == "__main__":
    sys.exit(main())
