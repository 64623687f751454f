"""What a realtime character costs the orchestrator: CPU milliseconds a look at it, thirty of which a second are due.

    python benchmarks/look_cost.py --seconds 10 --json out/look_cost.json

A character stands under the planner `stand` and the tracker `kinematic`, whose processes do not count; the loop is in
this process, without HTTP. CPU time over looks holds on a busy machine too, where there are fewer looks than are due.
"""

from __future__ import annotations

import argparse
import asyncio
import sys
import time
from pathlib import Path
from typing import Any

from orchestrator.cli.common import provenance, write_json
from orchestrator.core.character import CharacterSession, CharacterSpec
from orchestrator.core.events import EventLog
from orchestrator.core.supervise import Stack
from orchestrator.evaluation.executor import Pairing


async def measure(pairing: Pairing, stack: Stack, seconds: float) -> dict[str, Any]:
    """CPU milliseconds a look, and the cores that thirty looks a second make."""
    services = await pairing.connect(stack)
    session = CharacterSession("standing", CharacterSpec(pacing="realtime"), services, EventLog())
    try:
        await session.start()
        loop = session.loop
        look, looks = loop.look, 0

        async def counted(since_tick: int) -> Any:
            nonlocal looks
            looks += 1
            return await look(since_tick)

        loop.look = counted  # type: ignore[method-assign]
        began_s, began = time.process_time(), looks
        await asyncio.sleep(seconds)
        each_s = (time.process_time() - began_s) / max(looks - began, 1)
        return {"looks": looks - began, "cpu_ms_a_look": round(each_s * 1e3, 3), "cores": round(30 * each_s, 4)}
    finally:
        await session.close()
        await services.close()


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    pairing = Pairing("stand", "kinematic", planner_args=("--plugins", "stand"))
    stack = pairing.stack()
    try:
        result = asyncio.run(measure(pairing, stack, given.seconds))
    finally:
        stack.stop()
    write_json(given.json, {**result, **provenance()})
    return 0


if __name__ == "__main__":
    sys.exit(main())
