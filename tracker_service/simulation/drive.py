"""Who gives the servo targets of a tick: an action chunk while one lasts, else the tracker, guarded.

A tracker is a plug-in of anybody's, and what it raises must not stop a clock: whatever comes out of `act`, `decode` or
`reset` becomes `failure`, and from that very tick on the servos follow the reference until the tracker is resumed.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping

import numpy as np
import numpy.typing as npt

from shared.errors import InvalidInputError, SimulationError
from shared.plugins.interfaces import LatentTracker, Tracker, TrackerObservation
from shared.protocol.messages import SERVO_TARGETS, TICK_HZ
from tracker_service.policy.observations import feedforward_targets
from tracker_service.simulation.humanoid import Humanoid

Array = npt.NDArray[np.float64]
log = logging.getLogger(__name__)


class Driver:
    """See the module's docstring.

    Args:
        human: whose servos are driven.
        tracker: the plug-in.
        character_id: handed to it.

    Attributes:
        failure: why the tracker is not asked any more; None while it is.
    """

    def __init__(self, human: Humanoid, tracker: Tracker, character_id: str):
        self._human = human
        self._ratio = human.damping / human.stiffness
        self._character_id = character_id
        self._tracker = tracker
        self._start = 0
        self._rows: Array = np.zeros((0, len(human.hinges)))
        self._space = SERVO_TARGETS
        self.failure: str | None = None

    @property
    def tracker(self) -> Tracker:
        """The tracker in use."""
        return self._tracker

    @property
    def shows_pose(self) -> bool:
        """Whether the reference itself is shown, without physics."""
        return self._tracker.spec.drives == "pose" and self.failure is None

    def reset(self) -> None:
        """Forget the chunk; the tracker forgets what it knows of the character."""
        self._rows = self._rows[:0]
        if self.failure is None:
            self._ask_reset()

    def resume(self) -> None:
        """Ask the tracker again after it failed."""
        if self.failure is not None:
            self.failure = None
            self._ask_reset()

    def swap(self, tracker: Tracker) -> None:
        """Let another tracker drive; the rest of a chunk in a space it does not take is dropped.

        Raises:
            SimulationError: it cannot even be reset; the old one goes on.
        """
        try:
            tracker.reset([self._character_id])
        except (Exception, SystemExit) as error:
            log.exception("tracker %s failed in reset", tracker.spec.name)
            raise SimulationError(f"tracker {tracker.spec.name!r} failed in reset: {_said(error)}") from error
        self._tracker, self.failure = tracker, None
        if self._space not in tracker.spec.action_spaces:
            self._rows = self._rows[:0]

    def check_actions(self, actions: npt.NDArray[np.floating], space: str | None) -> None:
        """Raise InvalidInputError, naming the field, for a chunk (A, D) that the tracker does not take."""
        spec = self._tracker.spec
        if space not in spec.action_spaces:
            raise InvalidInputError(
                f"tracker {spec.name!r} takes no actions in the space {space!r}",
                field="action_space",
                allowed=", ".join(spec.action_spaces) or "no actions, or another tracker",
            )
        hinges = len(self._human.hinges)
        if actions.ndim != 2 or (space == SERVO_TARGETS and actions.shape[1] != hinges):
            raise InvalidInputError(
                f"the actions have shape {actions.shape}", field="actions", allowed=f"(A, {hinges})"
            )
        if not np.isfinite(actions).all():
            raise InvalidInputError("the actions are not finite", field="actions", allowed="finite numbers")

    def set_actions(self, start_tick: int, actions: npt.NDArray[np.floating], space: str = SERVO_TARGETS) -> None:
        """A chunk (A, D) for the ticks from start_tick on: row i drives the tick that ends at start_tick + i + 1.

        In the space `servo_targets` rows are targets in radians, and the tracker is not asked while they last; rows of
        another space go through its `decode` with the state of their tick.
        """
        self.check_actions(np.asarray(actions), space)
        self._start, self._rows, self._space = start_tick, np.asarray(actions, dtype=np.float64), space

    def end_actions(self, start_tick: int) -> None:
        """A plan without actions enters at a tick: what is left of an older chunk from there on is dropped."""
        self._rows = self._rows[: max(0, start_tick - self._start)]

    def targets(self, tick: int, observe: Callable[[], TrackerObservation]) -> Array:
        """(H,) servo targets in radians for the tick that begins now, within the hinges' limits.

        Raises:
            SimulationError: the targets are not finite.
        """
        row = tick - self._start
        chunk = self._rows[row] if 0 <= row < len(self._rows) else None
        plain = chunk is not None and self._space == SERVO_TARGETS
        targets = self._asked(tick, observe(), chunk) if chunk is None or not plain else chunk
        if not np.isfinite(targets).all():
            raise SimulationError(f"tracker {self._tracker.spec.name!r} gave non-finite targets at tick {tick}")
        return np.asarray(np.clip(targets, self._human.hinges.lower, self._human.hinges.upper))

    def to_arrays(self) -> dict[str, npt.NDArray[np.generic]]:
        """The chunk, for a snapshot."""
        return {"actions": self._rows, "actions_start": np.array(self._start), "actions_space": np.array(self._space)}

    def from_arrays(self, arrays: Mapping[str, npt.NDArray[np.generic]]) -> None:
        """Take over what `to_arrays` gave."""
        self._rows = np.asarray(arrays["actions"], dtype=np.float64)
        self._start, self._space = int(arrays["actions_start"]), str(arrays["actions_space"])

    def _asked(self, tick: int, observation: TrackerObservation, latents: Array | None) -> Array:
        if self.failure is None:
            call = "act" if latents is None else "decode"
            try:
                if latents is None:
                    given = self._tracker.act([self._character_id], [observation])
                elif isinstance(self._tracker, LatentTracker):
                    given = self._tracker.decode(latents[None], [observation])
                else:
                    raise TypeError("it has no decode")
                targets = np.asarray(given, dtype=np.float64)
                if targets.shape != (1, len(self._human.hinges)):
                    raise ValueError(f"it gave targets of shape {targets.shape}, not (1, {len(self._human.hinges)})")
                return targets[0]
            except (Exception, SystemExit) as error:
                log.exception("%s: tracker %s failed in %s", self._character_id, self._tracker.spec.name, call)
                self.failure = f"tracker {self._tracker.spec.name!r} failed in {call} at tick {tick}: {_said(error)}"
        ref = observation.ref_hinge_rad
        return np.asarray(feedforward_targets(ref[:1], ref[1:2], TICK_HZ, self._ratio)[0])

    def _ask_reset(self) -> None:
        try:
            self._tracker.reset([self._character_id])
        except (Exception, SystemExit) as error:
            log.exception("%s: tracker %s failed in reset", self._character_id, self._tracker.spec.name)
            self.failure = f"tracker {self._tracker.spec.name!r} failed in reset: {_said(error)}"


def _said(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}"[:500]
