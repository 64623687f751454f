"""The trackers this service offers: built-ins and those of installed packages."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path

from shared.errors import InvalidInputError, UnavailableError
from shared.plugins.interfaces import Tracker
from shared.plugins.registry import TRACKERS, PluginRegistry, current_name
from tracker_service.policy.learned import WEIGHTS
from tracker_service.policy.registry import tracker_factories
from tracker_service.simulation.character_spec import HUMAN, character
from tracker_service.simulation.humanoid import humanoid

PREFERRED = ("learned", "pd", "kinematic")


def builtin_trackers(weights: Path = WEIGHTS, character_name: str = HUMAN.name) -> dict[str, Callable[[], Tracker]]:
    """Name -> factory of the trackers that come with motionloop, for a character."""
    human = humanoid(character(character_name))
    return {name: _or_unavailable(make) for name, make in tracker_factories(human, weights).items()}


def _or_unavailable(make: Callable[[], Tracker]) -> Callable[[], Tracker]:
    """A factory whose missing weights withdraw its plug-in instead of ending the service."""

    def checked() -> Tracker:
        try:
            return make()
        except InvalidInputError as error:
            raise UnavailableError(error.message) from error

    return checked


def _drives(tracker: Tracker, character_name: str) -> bool:
    characters = tracker.spec.characters
    return characters is None or character_name in characters


class TrackerCatalogue:
    """Trackers by name and the default one.

    Args:
        only: names to offer; empty for all that can be made.
        default: name of the default; empty for the first there is of learned, pd, kinematic, others.
        builtin: factories by name.
    """

    def __init__(
        self,
        only: tuple[str, ...] = (),
        default: str = "",
        builtin: dict[str, Callable[[], Tracker]] | None = None,
    ):
        self._registry: PluginRegistry[Tracker] = PluginRegistry(
            TRACKERS, builtin_trackers() if builtin is None else builtin, [current_name(name) for name in only] or None
        )
        self._made = self._registry.load_all()
        self._ours = frozenset(builtin_trackers()) if builtin is None else frozenset(builtin)
        self._fitting: dict[tuple[str, str], Tracker] = {}
        self._lock = threading.Lock()
        if not self._made:
            raise InvalidInputError(f"no tracker can be loaded: {self._registry.withdrawn()}", field="trackers")
        default = current_name(default)
        if default and default not in self._made:
            raise InvalidInputError(f"no tracker {default!r}", field="default_tracker", allowed=", ".join(self._made))
        self.default = default or next((name for name in PREFERRED if name in self._made), next(iter(self._made)))

    def get(self, name: str | None, character_name: str = HUMAN.name) -> Tracker:
        """The tracker for a character; for None the default one, or the first that drives it.

        Raises:
            InvalidInputError: an unknown name, or one that does not drive the character; lists those that do.
        """
        able = [
            known
            for known in (self.default, *(n for n in PREFERRED if n in self._made), *self._made)
            if _drives(self._made[known], character_name)
        ]
        known = ", ".join(dict.fromkeys(able))
        if name is None:
            if not able:
                raise InvalidInputError(f"no tracker drives {character_name!r}", field="character", allowed=HUMAN.name)
            name = able[0]
        name = current_name(name)
        if name not in self._made:
            raise InvalidInputError(f"unknown tracker {name!r}", field="tracker", allowed=known)
        if name not in able:
            raise InvalidInputError(
                f"tracker {name!r} does not drive {character_name!r}", field="tracker", allowed=known
            )
        return self._made[name] if character_name == HUMAN.name else self._fitted(name, character_name)

    def _fitted(self, name: str, character_name: str) -> Tracker:
        """One of ours made for another character's servos; a plug-in of others' drives any as it is."""
        with self._lock:
            key = (name, character_name)
            if key not in self._fitting:
                own = builtin_trackers(character_name=character_name) if name in self._ours else {}
                self._fitting[key] = own[name]() if name in own else self._made[name]
            return self._fitting[key]

    def specs(self) -> list[dict[str, object]]:
        """What each tracker declares, as JSON objects, the default first."""
        names = [self.default, *(name for name in self._made if name != self.default)]
        return [self._made[name].spec.model_dump(mode="json") for name in names]
