"""Finding plug-ins: built-ins that a service registers, and entry points of installed packages.

A package offers a planner with

    [project.entry-points."motionloop.planners"]
    mine = "my_package:make_planner"        # called without arguments, returns a Planner
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterable, Mapping
from importlib.metadata import entry_points
from typing import Generic, TypeVar

from shared.errors import InvalidInputError, UnavailableError

P = TypeVar("P")
PLANNERS = "motionloop.planners"
TRACKERS = "motionloop.trackers"
TASKS = "motionloop.tasks"
log = logging.getLogger(__name__)

FORMER_NAMES = {"ppo": "learned"}
"""Plug-ins that were renamed; the old names are understood for one release."""


def current_name(name: str) -> str:
    """The present name of a plug-in; a former one is understood, and a line in the log says so."""
    if name not in FORMER_NAMES:
        return name
    log.warning("plug-in %r is called %r now; the old name goes with the next release", name, FORMER_NAMES[name])
    return FORMER_NAMES[name]


class PluginRegistry(Generic[P]):
    """Plug-ins by name, each made when first asked for and kept.

    Args:
        group: entry point group, PLANNERS or TRACKERS.
        builtin: name -> factory; these win over entry points of the same name. A factory that raises
            UnavailableError (weights or library absent) withdraws its plug-in.
        only: names to offer; None for all.
    """

    def __init__(self, group: str, builtin: Mapping[str, Callable[[], P]], only: Iterable[str] | None = None):
        self._factories: dict[str, Callable[[], P]] = {
            point.name: _from_entry_point(point.load) for point in entry_points(group=group)
        }
        self._factories.update(builtin)
        if only is not None:
            wanted = tuple(only)
            for name in wanted:
                if name not in self._factories:
                    raise InvalidInputError(f"no plug-in {name!r}", field="plugins", allowed=", ".join(self._factories))
            self._factories = {name: self._factories[name] for name in wanted}
        self._made: dict[str, P] = {}
        self._withdrawn: dict[str, str] = {}
        self._lock = threading.RLock()

    def names(self) -> tuple[str, ...]:
        """Names offered at present; loading one may still withdraw it."""
        return tuple(name for name in self._factories if name not in self._withdrawn)

    def withdrawn(self) -> dict[str, str]:
        """Name -> why a plug-in is not offered."""
        return dict(self._withdrawn)

    def load(self, name: str) -> P:
        """The plug-in; made now if need be.

        Raises InvalidInputError for a name that is not offered, UnavailableError if it cannot be made.
        """
        with self._lock:
            if name in self._made:
                return self._made[name]
            if name in self._withdrawn:
                raise UnavailableError(f"plug-in {name!r} is not available: {self._withdrawn[name]}", field="plugin")
            factory = self._factories.get(name)
            if factory is None:
                raise InvalidInputError(f"no plug-in {name!r}", field="plugin", allowed=", ".join(self.names()))
            try:
                self._made[name] = factory()
            except UnavailableError as error:
                self._withdrawn[name] = error.message
                log.warning("plug-in %s is not offered: %s", name, error.message)
                raise
            return self._made[name]

    def load_all(self) -> dict[str, P]:
        """All plug-ins that can be made, by name, in the order of registration."""
        with self._lock:
            for name in self.names():
                try:
                    self.load(name)
                except UnavailableError:
                    continue
            return {name: self._made[name] for name in self.names()}


def _from_entry_point(load: Callable[[], Callable[[], P]]) -> Callable[[], P]:
    """A factory that imports the package only when its plug-in is asked for."""

    def make() -> P:
        try:
            return load()()
        except (ImportError, AttributeError) as error:
            raise UnavailableError(f"its package does not load: {error}") from error

    return make
