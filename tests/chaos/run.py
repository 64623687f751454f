"""`python -m tests.chaos.run --faults 200`: faults in seeded random order over running episodes, and a report."""

from __future__ import annotations

import argparse
import json
import platform
import random
import sqlite3
import sys
import tempfile
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import httpx
import numpy as np

from tests.chaos.arena import Arena, StuckError, wrong
from tests.chaos.faults import FAULTS, PLANNER_ONLY, Fault, Scene, shuffled
from tests.chaos.processor import most_waited_s, waits
from tests.chaos.stack import ChaoticStack
from tests.orchestrator.support import kept_up

LOOK_S, STILL_LOOKS = 0.3, 8
"""Physics by the clock that shows the same tick so often stands still. Looks are counted, as on a slow machine the
looking takes longer too."""
ROWS = tuple(dict.fromkeys(fault.row for fault in FAULTS))


def chaos(faults: Sequence[Fault], seed: int, data_dir: Path, most_s: float, say: Any = print) -> dict[str, Any]:
    """Make the faults one after another; the report (see `report`).

    Args:
        most_s: no other fault is begun after so long.
    """
    began_s = time.monotonic()
    made: list[dict[str, Any]] = []
    with ChaoticStack(data_dir, seed) as stack, httpx.Client(base_url=stack.url, timeout=30.0) as http:
        arena = Arena(http)
        scene = Scene(stack, arena, random.Random(seed), data_dir)
        with kept_up(stack, stack.said.append):
            arena.wait(arena.going(), "episodes run")
            for number, fault in enumerate(faults):
                if time.monotonic() - began_s > most_s:
                    break
                entry = _one(scene, fault)
                made.append({"number": number, **entry})
                say(json.dumps(made[-1]))
            arena.finish()
    return {**report(made, arena, seed, time.monotonic() - began_s), "rescues": rescues(data_dir)}


def rescues(data_dir: Path) -> dict[str, Any]:
    """What it took to bring characters back from a lost tracker, as their events say: how many, `seconds` from the loss
    to the return, and the ticks done once more."""
    with closing(sqlite3.connect(data_dir / "motionloop.sqlite", timeout=30.0)) as store:
        told = [json.loads(row[0]) for row in store.execute("SELECT data FROM events WHERE type = 'tracker_back'")]
    out: dict[str, Any] = {"characters": len(told)}
    for name in ("seconds", "lost_ticks") if told else ():
        values = [float(each[name]) for each in told]
        out[name] = {
            **{f"p{q}": round(float(np.percentile(values, q)), 2) for q in (50, 95)},
            "most": max(values),
        }
    return out


def _one(scene: Scene, fault: Fault) -> dict[str, Any]:
    arena = scene.arena
    ended = len(arena.ended)
    entry: dict[str, Any] = {"fault": fault.name, "row": fault.row}
    began_s = time.monotonic()
    watch = _Watch(scene) if fault.row in PLANNER_ONLY else None
    try:
        fault.make(scene)
        if watch is not None:
            entry["stood_still"] = watch.stop()
        pids = [process.pid for process in scene.stack.processes()]
        since, before = arena.look() if fault.row != "orchestrator" else None, waits(pids)
        entry["recovered_s"] = round(arena.wait(arena.going(since), f"all go on after: {fault.name}"), 2)
        entry["no_processor_s"] = round(most_waited_s(before, waits(pids)), 2)
        entry["since_fault_s"] = round(time.monotonic() - began_s, 2)
        arena.check()
    except (StuckError, AssertionError, httpx.HTTPError) as error:
        entry["trouble"] = f"{type(error).__name__}: {error}"
    finally:
        if watch is not None:
            watch.stop()
    entry["ended"] = [f"{end.status}: {end.reason}" for end in arena.ended[ended:]]
    return entry


class _Watch:
    """Looks at the episodes by the clock that run, and tells of those whose tick did not move for a while."""

    def __init__(self, scene: Scene):
        self._arena = Arena(scene.arena.http, running=dict(scene.arena.running))
        self._seen: dict[str, tuple[int, int]] = {}
        self._still: set[str] = set()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="watch")
        self._thread.start()

    def _run(self) -> None:
        while not self._over.wait(LOOK_S):
            for episode_id, spec in self._arena.running.items():
                answer = self._arena.ask("GET", f"/v1/episodes/{episode_id}")
                if spec["pacing"] != "realtime" or answer is None or answer.status_code != 200:
                    continue
                told = answer.json()
                if told["status"] != "running":
                    continue  # one that has ended stands still by right
                tick = told.get("tick") or 0
                was, looks = self._seen.get(episode_id, (-1, 0))
                self._seen[episode_id] = tick, looks + 1 if tick == was else 0
                if self._seen[episode_id][1] >= STILL_LOOKS:
                    self._still.add(episode_id)

    def stop(self) -> list[str]:
        """Those that stood still."""
        self._over.set()
        self._thread.join()
        return sorted(self._still)


def report(made: list[dict[str, Any]], arena: Arena, seed: int, took_s: float) -> dict[str, Any]:
    """What has come of it. `recovery`: seconds until all went on, and for how many of them at most a thread of the four
    processes was ready to run and had no processor.

    `lost`, `stuck`, `wrong_recordings` and `stood_still` must be empty.
    """
    by_row: dict[str, list[float]] = defaultdict(list)
    unserved: dict[str, list[float]] = defaultdict(list)
    for entry in made:
        if "recovered_s" in entry:
            by_row[entry["row"]].append(entry["recovered_s"])
            unserved[entry["row"]].append(entry["no_processor_s"])
    rows = {
        row: {
            "faults": len(seconds),
            **{f"p{q}_s": round(float(np.percentile(seconds, q)), 2) for q in (50, 95)},
            "most_s": max(seconds),
            "no_processor_p95_s": round(float(np.percentile(unserved[row], 95)), 2),
        }
        for row, seconds in sorted(by_row.items())
    }
    return {
        "seed": seed,
        "faults": len(made),
        "seconds": round(took_s, 1),
        "recovery": rows,
        "episodes": {"started": arena.started, "ended": dict(Counter(end.status for end in arena.ended))},
        "reasons": dict(Counter(str(end.reason) for end in arena.ended)),
        "stuck": [entry for entry in made if "trouble" in entry],
        "stood_still": [entry for entry in made if entry.get("stood_still")],
        "lost": [end.id for end in arena.ended if end.status == "lost"],
        "wrong_recordings": wrong(arena.ended),
        "made": made,
        "machine": {"platform": platform.platform(), "python": platform.python_version()},
    }


def sound(found: dict[str, Any]) -> bool:
    """Whether all is as it must be."""
    return not any(found[name] for name in ("stuck", "stood_still", "lost", "wrong_recordings"))


def main() -> int:
    """Exit code 1 when an episode was lost or stuck, a recording is wrong, or physics stood still for a planner."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--faults", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--rows", default=",".join(ROWS), help="of the fault table, with commas between them")
    parser.add_argument("--json", type=Path, default=Path("out/chaos.json"))
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="chaos-") as folder:
        faults = shuffled(given.faults, given.seed, given.rows.split(","))
        found = chaos(faults, given.seed, Path(folder), 60.0 * given.minutes)
    given.json.parent.mkdir(parents=True, exist_ok=True)
    given.json.write_text(json.dumps(found, indent=1))
    print(json.dumps({name: value for name, value in found.items() if name != "made"}, indent=1))
    return 0 if sound(found) else 1


if __name__ == "__main__":
    sys.exit(main())
