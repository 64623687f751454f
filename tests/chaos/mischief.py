"""A planner service whose plans can be spoilt from outside: `python -m tests.chaos.mischief --file F`.

The file says what is done to how many of the next plans, and a number that changes with every order: `nan 2 17`. That
number is written beside it, with the ending `.done`, when it is carried out.
"""

from __future__ import annotations

import argparse
import signal
import threading
import time
from pathlib import Path

import numpy as np

from planner_service.builtin.stand import StandPlanner
from planner_service.service.service import PlannerService
from planner_service.service.settings import PlannerSettings
from shared.plugins.interfaces import Planner
from shared.plugins.registry import PLANNERS, PluginRegistry
from shared.protocol.messages import Plan, PlanRequest

SLOW_S = 1.5


class Mischief:
    """`stand`, whose plans are spoilt on demand.

    Args:
        file: where the orders are.
    """

    def __init__(self, file: Path):
        self._stand = StandPlanner()
        self.spec = self._stand.spec
        self._file = file
        self._done = file.with_suffix(".done")
        self._order = ""
        self._left = 0
        order = file.read_text() if file.exists() else ""
        if self._done.exists() and order.endswith(f" {self._done.read_text()}"):
            self._order = order  # by the process before this one

    def plan(self, requests: list[PlanRequest]) -> list[Plan]:
        """Plans, some of them spoilt."""
        plans = self._stand.plan(requests)
        return [self._spoilt(plan, kind) if (kind := self._next()) else plan for plan in plans]

    def _next(self) -> str | None:
        order = self._file.read_text() if self._file.exists() else ""
        if order != self._order:
            self._order = order
            self._left = int(order.split()[1]) if order else 0
        if self._left == 0:
            return None
        self._left -= 1
        if self._left == 0:
            self._done.write_text(order.split()[2])
        return order.split()[0]

    @staticmethod
    def _spoilt(plan: Plan, kind: str) -> Plan:
        if kind == "raise":
            raise RuntimeError("as ordered")
        if kind == "slow":
            time.sleep(SLOW_S)
        if kind == "late_start":
            return plan.model_copy(update={"start_tick": plan.start_tick + 3})
        if kind == "other_rate":
            return plan.model_copy(update={"fps": 10 if plan.fps != 10 else 20})
        if kind == "nan":
            return plan.model_copy(update={"positions_w_m": np.full_like(plan.positions_w_m, np.nan)})
        if kind == "far":
            return plan.model_copy(update={"positions_w_m": plan.positions_w_m + np.float32(50.0)})
        return plan


def main() -> None:
    """Serve until SIGTERM."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--endpoint", required=True)
    parser.add_argument("--file", type=Path, required=True)
    given = parser.parse_args()
    stop = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    planner: Planner = Mischief(given.file)
    registry: PluginRegistry[Planner] = PluginRegistry(PLANNERS, {"stand": lambda: planner})
    with PlannerService(PlannerSettings(endpoint=given.endpoint), registry=registry) as service:
        print(f"planner ready at {service.endpoint}", flush=True)
        while not stop.wait(0.5):
            continue


if __name__ == "__main__":
    main()
