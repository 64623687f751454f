"""Episodes that run while faults are made, as seen over HTTP: who lives, who goes on, how they ended."""

from __future__ import annotations

import io
import json
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import httpx
import numpy as np

GIVE_UP_S = 400.0
LOOK_S = 0.1
TASKS: list[dict[str, Any]] = [{"type": "halt", "duration_s": 20}, {"type": "text", "text": "a person stands."}] * 30
SPECS: tuple[dict[str, Any], ...] = (
    {"pacing": "realtime", "tracker": "kinematic", "tasks": TASKS},
    {"pacing": "realtime", "tracker": "pd", "tasks": TASKS},
    {"pacing": "lockstep", "tracker": "kinematic", "tasks": TASKS},
)
SPARE_TICKS = 31
"""By the clock some ticks pass before an end is noticed: a recording may hold them."""


class StuckError(AssertionError):
    """Something that should have come has not."""


@dataclass
class Ended:
    """How an episode ended."""

    id: str
    pacing: str
    status: str
    reason: str | None
    trouble: str | None = None
    """What is wrong with its recording or its end; None where all is well."""
    events: list[dict[str, Any]] = field(default_factory=list)
    """What happened in it, where something is wrong."""


def wrong(ended: list[Ended]) -> list[dict[str, Any]]:
    """Those with something wrong: what, and their events."""
    return [{"id": end.id, "trouble": end.trouble, "events": end.events} for end in ended if end.trouble]


@dataclass
class Arena:
    """The episodes of one stack.

    Attributes:
        http: of the orchestrator.
        specs: of the episodes, one of each at any time.
        running: specs by id.
        ended: those that are over.
    """

    http: httpx.Client
    specs: tuple[dict[str, Any], ...] = SPECS
    running: dict[str, dict[str, Any]] = field(default_factory=dict)
    ended: list[Ended] = field(default_factory=list)
    started: int = 0
    _unchecked: list[tuple[Ended, dict[str, Any]]] = field(default_factory=list)

    def ask(self, method: str, path: str, body: dict[str, Any] | None = None) -> httpx.Response | None:
        """The answer; None while nobody answers."""
        try:
            return self.http.request(method, path, json=body)
        except httpx.TransportError:
            return None

    def fill(self) -> None:
        """Have as many episodes running as there should be."""
        wanted = [spec for spec in self.specs if spec not in self.running.values()]
        for spec in wanted:
            answer = self.ask("POST", "/v1/episodes", {**spec, "seed": self.started})
            if answer is not None and answer.status_code == 201:
                self.running[answer.json()["id"]] = spec
                self.started += 1

    def look(self) -> dict[str, dict[str, Any]]:
        """What is told of the running ones; those that are over are taken out. Empty while nobody answers."""
        out: dict[str, dict[str, Any]] = {}
        for episode_id in list(self.running):
            answer = self.ask("GET", f"/v1/episodes/{episode_id}")
            if answer is None or answer.status_code >= 500:
                return {}
            if answer.status_code == 404:
                self._over(episode_id, {"status": "lost", "reason": None})
            elif (told := answer.json())["status"] != "running":
                self._over(episode_id, told)
            else:
                out[episode_id] = told
        return out

    def ask_for_plans(self) -> bool:
        """See that there are episodes which want plans; always true."""
        self.look()
        self.fill()
        return True

    def wait(self, condition: Callable[[], bool], what: str) -> float:
        """Seconds until it held; raises StuckError."""
        began_s = time.monotonic()
        while not condition():
            if time.monotonic() - began_s > GIVE_UP_S:
                raise StuckError(f"never: {what}")
            time.sleep(LOOK_S)
        return time.monotonic() - began_s

    def going(self, since: dict[str, dict[str, Any]] | None = None) -> Callable[[], bool]:
        """A condition: every running episode has moved on from `since` (or from the first look), none is degraded."""
        first = dict(since or {})

        def holds() -> bool:
            self.fill()
            now = self.look()
            if len(now) < len(self.running) or not now:
                return False
            for episode_id, told in now.items():
                first.setdefault(episode_id, told)
            return all(
                told["phase"] != "degraded" and told["tick"] != first[episode_id]["tick"]
                for episode_id, told in now.items()
            )

        return holds

    def finish(self) -> None:
        """Cancel what runs and wait for its end."""
        for episode_id in list(self.running):
            self.wait(lambda known=episode_id: self._cancelled(known), "it is cancelled")
        self.wait(lambda: not self.look() and not self.running, "all have ended")
        self.check()

    def _cancelled(self, episode_id: str) -> bool:
        answer = self.ask("DELETE", f"/v1/episodes/{episode_id}")
        if answer is not None and answer.json().get("status") == "deleted":  # it had come to its end by itself
            del self.running[episode_id]
        return answer is not None

    def check(self) -> None:
        """See whether the recordings of those that ended since are whole. Apart from the look at who goes on, which
        must not wait for the making of files."""
        for end, told in self._unchecked:
            end.trouble = self._trouble(end, told)
            if end.trouble is not None:
                end.events = self._events(end.id)
        self._unchecked = []

    def _events(self, episode_id: str) -> list[dict[str, Any]]:
        answer = self.ask("GET", f"/v1/episodes/{episode_id}/events")
        if answer is None or answer.status_code != 200:
            return []
        return [json.loads(line[6:]) for line in answer.text.splitlines() if line.startswith("data: ")]

    def _over(self, episode_id: str, told: dict[str, Any]) -> None:
        spec = self.running.pop(episode_id)
        end = Ended(episode_id, spec["pacing"], told["status"], told["reason"])
        self.ended.append(end)
        self._unchecked.append((end, told))

    def _trouble(self, end: Ended, told: dict[str, Any]) -> str | None:
        if end.status == "lost":
            return "nobody knows it any more"
        if end.status in ("failed", "interrupted") and not end.reason:
            return "it ended without a reason"
        if not told.get("outcome"):
            return None  # it was never begun, or interrupted: there is no number of ticks to compare with
        ticks = told["outcome"]["ticks"]
        answer: list[httpx.Response] = []

        def there() -> bool:
            reply = self.ask("GET", f"/v1/episodes/{end.id}/motion.npz")
            answer[:] = [] if reply is None or reply.status_code != 200 else [reply]
            return bool(answer) or ticks == 0

        try:
            self.wait(there, f"the recording of {end.id}")
        except StuckError as error:
            return str(error)
        if not answer:
            return None
        with np.load(io.BytesIO(answer[0].content), allow_pickle=False) as data:
            start, count = int(data["start_tick"]), len(data["body_pos_w_m"])
        more = count - (ticks + 1)
        if start != 0 or not 0 <= more <= (SPARE_TICKS if end.pacing == "realtime" else 0):
            return f"{count} ticks from {start} are recorded of {ticks}"
        return None
