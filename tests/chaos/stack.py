"""The stack that chaos is made in: proxies between the processes, a second tracker, whatever ends is started again."""

from __future__ import annotations

import shutil
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

from orchestrator.core.supervise import ServiceProcess, Stack
from tests.orchestrator.support import LIGHT
from tests.protocol.chaos_proxy import ChaosProxy

FREE = "tcp://127.0.0.1:0"


class ChaoticStack(Stack):
    """As `Stack`; the planner takes orders for mischief, and both links of the orchestrator go through a proxy.

    Args:
        data_dir: of the orchestrator.
        seed: of what the proxies do.
        rescue_s: how long lost characters are looked for.
    """

    def __init__(self, data_dir: Path, seed: int, rescue_s: float = 120.0):
        self._orders = Path(tempfile.mkdtemp(prefix="mischief-")) / "orders"
        self._ordered = 0
        self._seed = seed
        self.links: dict[str, ChaosProxy] = {}
        self.said: list[str] = []
        """By whoever keeps the stack up."""
        self.spare = ServiceProcess("spare", [sys.executable, "-m", "tracker_service", "--endpoint", FREE])
        self._rescue_s = rescue_s
        super().__init__(replace(LIGHT, data_dir=str(data_dir)))

    def start(self, timeout_s: float = 180.0) -> str:
        """Start all four processes."""
        self.spare.start()
        try:
            self.spare.wait_ready(timeout_s)
        except BaseException:
            self.stop()
            raise
        return super().start(timeout_s)

    def ready(self, name: str) -> bool:
        """Whether a process that was started again has said that it serves."""
        pid = next(each.pid for each in self.processes() if each.name == name)
        return any(line.startswith(f"{name}: ") and f"(pid {pid})" in line for line in self.said)

    def order(self, kind: str, plans: int) -> None:
        """Have so many of the next plans spoilt."""
        self._ordered += 1
        partial = self._orders.with_suffix(".partial")
        partial.write_text(f"{kind} {plans} {self._ordered}")
        partial.replace(self._orders)

    def carried_out(self) -> bool:
        """Whether the newest order is."""
        done = self._orders.with_suffix(".done")
        return done.exists() and done.read_text() == str(self._ordered)

    def processes(self) -> list[ServiceProcess]:
        """With the second tracker."""
        return [*super().processes(), self.spare]

    def restart(self, name: str) -> ServiceProcess:
        """As `Stack.restart`."""
        if name != "spare":
            return super().restart(name)
        old = self.spare
        old.stop()
        command = [sys.executable, "-m", "tracker_service", "--endpoint", old.address]
        self.spare = ServiceProcess("spare", command)
        self.spare.address = old.address
        self.spare.start()
        return self.spare

    def stop(self) -> None:
        """End all processes, then the proxies."""
        super().stop()
        for link in self.links.values():
            link.close()
        self.links = {}
        shutil.rmtree(self._orders.parent, ignore_errors=True)

    def _planner(self, endpoint: str) -> ServiceProcess:
        command = [sys.executable, "-m", "tests.chaos.mischief", "--endpoint", endpoint, "--file", str(self._orders)]
        return ServiceProcess("planner", command)

    def _orchestrator(self, planner: str, tracker: str, port: int) -> ServiceProcess:
        if not self.links:
            self.links = {
                "planner": ChaosProxy(planner, self._seed, 0.0).open(),
                "tracker": ChaosProxy(tracker, self._seed + 1, 0.0).open(),
            }
        more = ("--spare-trackers", self.spare.address, "--rescue-s", str(self._rescue_s), "--max-running", "8")
        self.options = replace(self.options, orchestrator_args=more)
        return super()._orchestrator(self.links["planner"].endpoint, self.links["tracker"].endpoint, port)
