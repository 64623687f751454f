"""Whether more commands than the server can take are turned away in good order while characters keep their clock.

    python -m benchmarks.overload --minutes 30 --json out/overload.json

`--rate` commands a second, another sentence each time, go to realtime characters from ten addresses, over more
connections than requests are handled at once (503). An eleventh address asks as often for characters beyond those that
may run (429). A connection asks again when it has its answer, so that fewer are sent where answers take long. The
memory of the services is noted every ten seconds; ticks are asked of the tracker itself, also for `--calm` minutes
before the flood. Planner and tracker are the trained ones unless others are named.
"""

from __future__ import annotations

import argparse
import asyncio
import itertools
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import psutil

from benchmarks.flood import REFUSED, Told, flood
from orchestrator.cli.common import console, provenance, write_json
from orchestrator.core.supervise import Stack, StackOptions
from shared.protocol.messages import Observe, StateFrame
from shared.protocol.rates import TICK_HZ
from shared.protocol.transport import ServiceClient
from tests.chaos.processor import Waits, most_waited_s, waits

TEXTS = ("a person is walking.", "a person is standing still.", "a person waves with the right hand.", "turn left.")
CALLERS, CONNECTIONS = 10, 32
SAMPLE_S = 10.0
GROWTH_MB = 32.0
"""More than this between the second and the last third is growth, not noise."""
MISSED_SHARE = 0.005
MEGABYTE = 2**20


def post(url: str, path: str, value: dict[str, Any]) -> bytes:
    """A whole request."""
    body = json.dumps(value).encode()
    head = (
        f"POST {path} HTTP/1.1\r\nhost: {url.partition('//')[2]}\r\n"
        f"content-type: application/json\r\ncontent-length: {len(body)}\r\n\r\n"
    )
    return head.encode() + body


def growth_mb(samples: list[float]) -> float:
    """Median of the last third less that of the second."""
    third = max(len(samples) // 3, 1)
    return round(float(np.median(samples[-third:]) - np.median(samples[third : 2 * third] or samples)), 1)


def memory(samples: list[tuple[float, float]]) -> dict[str, float]:
    """Figures of (seconds, MB): how much at first, at last and at most; MB an hour over the latter half."""
    seconds, mb = np.array(samples).T
    late = seconds >= 0.5 * seconds[-1]
    slope = np.polyfit(seconds[late], mb[late], 1)[0] * 3600 if late.sum() > 1 else 0.0
    return {
        "first_mb": round(float(mb[0]), 1),
        "last_mb": round(float(mb[-1]), 1),
        "max_mb": round(float(mb.max()), 1),
        "mb_per_h_latter_half": round(float(slope), 1),
        "growth_mb": growth_mb(mb.tolist()),
    }


class Watch:
    """Notes what the services hold and how the characters' clocks go."""

    def __init__(self, stack: Stack, tracker: ServiceClient, characters: list[str]):
        self._tracker, self._characters = tracker, characters
        self._processes = {each.name: psutil.Process(each.pid) for each in stack.processes()}
        self._began_s = time.monotonic()
        self.rss: dict[str, list[tuple[float, float]]] = {name: [] for name in self._processes}

    def states(self) -> list[StateFrame]:
        """Of the characters, by the tracker."""
        return [self._tracker.ask(Observe(), StateFrame, each, timeout_s=60.0) for each in self._characters]

    def cpu_s(self) -> dict[str, float]:
        """What each process, and this one, has had of the processors."""
        spent = {name: each.cpu_times() for name, each in {**self._processes, "callers": psutil.Process()}.items()}
        return {name: each.user + each.system for name, each in spent.items()}

    def waits(self) -> Waits:
        """How long each thread of the tracker was ready to run and was not let."""
        return waits([self._processes["tracker"].pid])

    def note(self) -> None:
        """The memory now."""
        at_s = time.monotonic() - self._began_s
        for name, process in self._processes.items():
            self.rss[name].append((round(at_s, 1), round(process.memory_info().rss / MEGABYTE, 1)))


async def overload(
    stack: Stack, characters: int, rate: float, calm_s: float, seconds: float, seed: int
) -> dict[str, Any]:
    """Make characters, look on without a flood, and under one."""
    with httpx.Client(base_url=stack.url, timeout=60.0) as http:
        made = [http.post("/v1/characters", json={"pacing": "realtime", "seed": seed + i}) for i in range(characters)]
        ids = [str(each.raise_for_status().json()["id"]) for each in made]
    paths = [f"/v1/characters/{each}/commands" for each in ids]
    commands = itertools.cycle([post(stack.url, path, {"text": text}) for text in TEXTS for path in paths])
    one_more = itertools.repeat(post(stack.url, "/v1/characters", {"pacing": "realtime"}))
    told, asked_more = Told(), Told()
    with ServiceClient(stack.tracker.address, "tracker") as tracker:
        watch = Watch(stack, tracker, ids)
        before = await stretch(watch, calm_s)
        every = CONNECTIONS, rate / CALLERS
        floods = [flood(stack.url, f"127.0.0.{2 + i}", *every, commands.__next__, told) for i in range(CALLERS)]
        floods.append(flood(stack.url, "127.0.0.1", *every, one_more.__next__, asked_more))
        tasks = [asyncio.ensure_future(each) for each in floods]
        under = await stretch(watch, seconds)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    with httpx.Client(base_url=stack.url, timeout=60.0) as http:
        again_s = _calm_after_s(http)
        services = http.get("/v1/services").json()
    return {
        "characters": characters,
        "asked_per_s": rate,
        "commands": _figures(told, under["seconds"]),
        "more_characters": _figures(asked_more, under["seconds"]),
        "before": before,
        "under": under,
        "memory": {name: memory(samples) for name, samples in watch.rss.items()},
        "ready_after_s": again_s,
        "planner": services["planner"]["plugin"],
        "tracker": services["tracker"]["plugin"],
        "samples": watch.rss,
    }


async def stretch(watch: Watch, seconds: float) -> dict[str, Any]:
    """Look on for so long: clocks, cores, and how long the tracker's thread that waited most for a processor did."""
    first, spent, waited = await asyncio.to_thread(watch.states), watch.cpu_s(), watch.waits()
    began_s = time.monotonic()
    while (left_s := seconds - (time.monotonic() - began_s)) > 0:
        watch.note()
        await asyncio.sleep(min(SAMPLE_S, left_s))
    watch.note()
    last, took_s = await asyncio.to_thread(watch.states), time.monotonic() - began_s
    ticks = sum(b.tick - a.tick for a, b in zip(first, last, strict=True))
    missed = sum(b.missed_ticks - a.missed_ticks for a, b in zip(first, last, strict=True))
    return {
        "seconds": round(took_s, 1),
        "ticks": ticks,
        "realtime_factor": round(ticks / len(first) / TICK_HZ / took_s, 4),
        "missed_ticks": missed,
        "missed_share": round(missed / max(ticks, 1), 5),
        "cores": {name: round((s - spent[name]) / took_s, 2) for name, s in watch.cpu_s().items()},
        "tracker_without_a_processor": round(most_waited_s(waited, watch.waits()) / took_s, 3),
    }


def _calm_after_s(http: httpx.Client) -> float:
    """Until an ordinary request is taken once the flood is over."""
    began_s = time.monotonic()
    while http.get("/v1/characters").status_code in REFUSED:
        time.sleep(0.05)
    return round(time.monotonic() - began_s, 2)


def _figures(told: Told, seconds: float) -> dict[str, Any]:
    answered = sum(told.statuses.values())
    return {
        "answered_per_s": round(answered / seconds, 1),
        "statuses": {str(status): count for status, count in sorted(told.statuses.items())},
        "refused_without_a_time": told.without_a_time,
        "broken": told.broken,
        "taken_ms": {"p50": told.percentile_ms(50), "p99": told.percentile_ms(99)},
    }


def sound(result: dict[str, Any]) -> bool:
    """Nothing but taken and refused, every refusal with a time, clocks kept, memory bounded."""
    sides = result["commands"], result["more_characters"]
    answers = {status for side in sides for status in side["statuses"]}
    return (
        answers <= {"202", *map(str, REFUSED)}
        and bool(answers & set(map(str, REFUSED)))
        and not any(side["refused_without_a_time"] or side["broken"] for side in sides)
        and result["under"]["missed_share"] < MISSED_SHARE
        and all(each["growth_mb"] < GROWTH_MB for each in result["memory"].values())
    )


def main() -> int:
    """Exit code 1 when an answer was neither taken nor a refusal with a time, ticks were missed, or memory grew."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--calm", type=float, default=1.0, help="minutes before the flood, to compare with")
    parser.add_argument("--rate", type=float, default=5000.0, help="commands a second, of ten callers together")
    parser.add_argument("--characters", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--planner", default=None, help="planner plug-in")
    parser.add_argument("--tracker", default=None, help="tracker plug-in")
    parser.add_argument("--json", type=Path, default=None, help="write the result to this file")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder) / "data"
        options = StackOptions(
            planner_plugin=given.planner, tracker_plugin=given.tracker, data_dir=str(data),
            orchestrator_args=("--max-running", str(given.characters)),
        )  # fmt: skip
        with Stack(options, console.print) as stack:
            result = asyncio.run(
                overload(stack, given.characters, given.rate, given.calm * 60, given.minutes * 60, given.seed)
            )
        stored = sum(path.stat().st_size for path in data.rglob("*") if path.is_file())
    command = " ".join(["python", "-m", "benchmarks.overload", *sys.argv[1:]])
    whole = {**result, "stored_mb": round(stored / MEGABYTE, 1), "sound": sound(result)}
    write_json(given.json, {**whole, **provenance(given.seed), "command": command})
    return 0 if whole["sound"] else 1


if __name__ == "__main__":
    sys.exit(main())
