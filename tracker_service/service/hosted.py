"""One hosted character: the simulation with its recording, its pacing and its failures, behind one lock."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from shared.errors import ConflictError, InvalidInputError, SimulationError
from shared.motion.heading import heading_of
from shared.motion.rotations import matrix_from_quat
from shared.motion.skeleton import Skeleton
from shared.plugins.interfaces import Tracker
from shared.protocol.base import PROTOCOL_VERSION
from shared.protocol.messages import (
    LOG_HZ,
    TICK_HZ,
    GetTicks,
    Look,
    Pacing,
    SetObject,
    Snapshot,
    StateFrame,
    TickRange,
    Track,
    TrackReply,
)
from tracker_service.service.dumps import dump_state
from tracker_service.service.entering import Entering
from tracker_service.service.log_tail import pack_tail, split_buffers
from tracker_service.service.plan_check import check_plan, late_reason
from tracker_service.service.replies import check_range, state_frame, tick_range
from tracker_service.service.settings import TrackerServiceSettings
from tracker_service.simulation.character import SimulatedCharacter
from tracker_service.simulation.recorder import Recorder, Samples, sample_stride

SAMPLES_A_TICK = LOG_HZ // TICK_HZ
TAIL_SAMPLES = 3 * LOG_HZ
"""Samples of the log that travel in a snapshot: three seconds, so that a restored character has its prefix."""
MAX_LOOK_TICKS = 30 * TICK_HZ
Xy = tuple[float, float]
log = logging.getLogger(__name__)


@dataclass
class Clock:
    """Pacing of a character and how well it kept its time."""

    pacing: Pacing
    paused: bool = False
    missed_ticks: int = 0


class HostedCharacter:
    """A simulated character with its log. All methods may be called from any thread.

    Args:
        character_id: from the envelope.
        simulation: the character, standing at its start.
        recorder: its empty log.
        pacing: `lockstep` or `realtime`.
        seed: of the character; kept with its snapshots.
        settings: limits for plans.
        dump_dir: where a failed state is written for replay.
        on_tick: told how many seconds each tick took to compute.
    """

    def __init__(
        self,
        character_id: str,
        simulation: SimulatedCharacter,
        recorder: Recorder,
        pacing: Pacing,
        seed: int,
        settings: TrackerServiceSettings,
        dump_dir: Path,
        on_tick: Callable[[float], None],
    ):
        self.character_id = character_id
        self.clock = Clock(pacing)
        self.seed = seed
        self._failure: str | None = None
        self.closed = False
        self._lock = threading.RLock()
        self._simulation = simulation
        self._recorder = recorder
        self._settings = settings
        self._dump_dir = dump_dir
        self._on_tick = on_tick
        self._entering = Entering(character_id)
        self._log(simulation.sample())
        self._last_good = simulation.snapshot()

    @property
    def skeleton(self) -> Skeleton:
        """The character's skeleton."""
        return self._simulation.human.skeleton

    @property
    def tick(self) -> int:
        """The present tick."""
        return self._simulation.tick

    @property
    def failure(self) -> str | None:
        """Why the last tick failed, or why its tracker is not asked any more."""
        return self._failure or self._simulation.driver.failure

    @property
    def simulation(self) -> SimulatedCharacter:
        """The simulation now in place; SetScene exchanges it."""
        return self._simulation

    def advance(self, ticks: int) -> StateFrame:
        """Run some ticks; stops at the first at which physics fails, with `failure` set in the frame."""
        with self._lock:
            self._check_open()
            for _ in range(ticks):
                try:
                    began_s = time.perf_counter()
                    self._log(self._simulation.step(1))
                    self._on_tick(time.perf_counter() - began_s)
                    self._entering.ticked(self.tick)
                except SimulationError as error:
                    self._fail(error.message)
                    break
                except Exception as error:  # whatever it is, the clock goes on and the reason is seen
                    log.exception("%s: a tick broke", self.character_id)
                    self._fail(f"a tick broke: {type(error).__name__}: {error}")
                    break
            return self.frame()

    def lockstep(self, ticks: int) -> StateFrame:
        """`advance` on request.

        Raises:
            ConflictError: the character is paced by the wall clock.
        """
        with self._lock:
            if self.clock.pacing != "lockstep":
                raise ConflictError("a realtime character steps by itself", field="pacing", allowed="lockstep")
            self._failure = None
            return self.advance(ticks)

    def realtime_tick(self) -> StateFrame | None:
        """`advance` by one tick on the clock's behalf; None if the character is paused or no longer realtime."""
        with self._lock:
            if self.clock.pacing != "realtime" or self.clock.paused:
                return None
            return self.advance(1)

    def track(self, message: Track) -> TrackReply:
        """Follow a plan, or drop it for being late; raises InvalidInputError for an unsound one, changing nothing."""
        with self._lock:
            self._check_open()
            now = self.tick
            if len(message.actions):
                self._simulation.driver.check_actions(message.actions, message.action_space)
            check_plan(message, self.skeleton, self._last_row()["body_pos_w_m"][0], self._settings)
            if message.start_tick > now + self._settings.max_ahead_ticks:
                raise InvalidInputError(
                    f"start_tick {message.start_tick} is too far ahead of tick {now}",
                    field="start_tick",
                    allowed=f"<= {now + self._settings.max_ahead_ticks}",
                )
            reason = late_reason(message, now, self._settings)
            if reason is not None:
                return TrackReply(accepted=False, tick=now, reason=reason)
            simulation, reference = self._simulation, self._simulation.reference
        # Inverse kinematics takes as long as several ticks, which must not wait for it.
        prepared = simulation.prepared_reference(message.start_tick, message.positions_w_m, message.fps)
        with self._lock:
            self._check_open()
            now = self.tick
            if self._simulation is not simulation or simulation.reference is not reference:
                # Reset, restored or given another plan in between: this plan comes on top of that.
                prepared = self._simulation.prepared_reference(message.start_tick, message.positions_w_m, message.fps)
            driver = self._simulation.driver
            if len(message.actions) and message.action_space is not None:
                driver.set_actions(message.start_tick, message.actions, message.action_space)
            else:
                driver.end_actions(message.start_tick)
            self._simulation.enter(message.start_tick, prepared, message.may_be_low)
            self._recover()
            self._last_good = self._simulation.snapshot()
            entered = max(now, message.start_tick)
            self._entering.expect(entered)
            return TrackReply(accepted=True, tick=now, entered_tick=entered)

    def impulse(self, body: str, impulse_w_ns: tuple[float, float, float]) -> None:
        """Push a body; raises InvalidInputError for an unknown one or too strong a push."""
        limit = self._settings.impulse_limit_ns
        if float(np.linalg.norm(impulse_w_ns)) > limit:
            raise InvalidInputError(
                f"an impulse of {np.linalg.norm(impulse_w_ns):.0f} N s",
                field="impulse_w_ns",
                allowed=f"<= {limit:g} N s",
            )
        if body not in self.skeleton.names:
            raise InvalidInputError(f"unknown body {body!r}", field="body", allowed=", ".join(self.skeleton.names))
        with self._lock:
            self._check_open()
            self._simulation.impulse(body, impulse_w_ns)
            self._last_good = self._simulation.snapshot()

    def set_object(self, message: SetObject) -> StateFrame:
        """Move an object at once; raises InvalidInputError, changing nothing, for one that cannot move so."""
        with self._lock:
            self._check_open()
            self._simulation.set_object(
                message.name, message.position_w_m, message.quat_w, message.linvel_w_mps, message.angvel_w_radps
            )
            kept = self._recorder.read(self._recorder.next_sample - 1, self._recorder.next_sample)
            of_the_tick = self._last["contact_impulse_ns"]
            self._log_jump({"contact_impulse_ns": kept["contact_impulse_ns"]})
            self._last["contact_impulse_ns"] = of_the_tick
            return self.frame()

    def reset(self, xy_w_m: Xy | None, heading_rad: float | None) -> StateFrame:
        """Stand up at a place (None: where it is, facing as it does); clock and log go on."""
        with self._lock:
            self._check_open()
            self._stand_up(*self._place(xy_w_m, heading_rad))
            self._recover()
            return self.frame()

    def replace_simulation(self, simulation: SimulatedCharacter) -> StateFrame:
        """Go on in another world (SetScene): `simulation` takes over the clock, the log continues."""
        with self._lock:
            self._check_open()
            simulation.tick = self.tick
            simulation.reset(*self._place(None, None))
            self._simulation = simulation
            self._log_jump()
            self._recover()
            return self.frame()

    def set_tracker(self, tracker: Tracker) -> None:
        """Let another tracker drive from the next tick on."""
        with self._lock:
            self._check_open()
            self._simulation.set_tracker(tracker)
            self._failure = None
            self._last_good = self._simulation.snapshot()

    def set_pacing(self, pacing: Pacing, paused: bool) -> StateFrame:
        """Change who advances the character; the caller tells the realtime clock."""
        with self._lock:
            self._check_open()
            self.clock.pacing, self.clock.paused = pacing, paused
            return self.frame()

    def frame(self) -> StateFrame:
        """The present state."""
        with self._lock:
            self._check_open()
            return state_frame(
                self.character_id, self._simulation, self._last_row(), self.failure, self.clock.pacing,
                self.clock.paused, self.clock.missed_ticks,
            )  # fmt: skip

    def ticks(self, message: GetTicks) -> TickRange:
        """A range of the log. Raises InvalidInputError for one that has not happened yet, or is too long."""
        stride = sample_stride(message.rate_hz)
        now, objects = self.tick, self._simulation.scene.object_names
        start, stop = message.start_tick * SAMPLES_A_TICK, message.stop_tick * SAMPLES_A_TICK
        check_range(message, now, stride)
        # A realtime tick counts up before its samples are in the log: what is not there yet is not read.
        there = min(now * SAMPLES_A_TICK + 1, self._recorder.next_sample)
        samples = self._recorder.read(start, min(stop, there), stride)
        impulses = self._recorder.read_sums("contact_impulse_ns", start, min(stop, there), stride)
        return tick_range(message, samples, impulses, objects)

    def look(self, since_tick: int) -> Look:
        """State and log since a tick (of the last 30 s at most) in one go, while no tick is under way."""
        with self._lock:
            state = self.frame()
            first = max(min(since_tick, state.tick), state.tick + 1 - MAX_LOOK_TICKS)
            message = GetTicks(start_tick=first, stop_tick=state.tick + 1, include_reference=True)
            return Look.of(state, self.ticks(message))

    def snapshot(self) -> Snapshot:
        """Everything needed to go on bit for bit, and the last three seconds of the log."""
        with self._lock:
            self._check_open()
            meta, state, buffers = self._simulation.snapshot()
            last = self.tick * SAMPLES_A_TICK
            first = max(self._recorder.first_sample, last + 1 - TAIL_SAMPLES)
            tail = pack_tail(self._recorder.read(first, last + 1))
            about = {"format": PROTOCOL_VERSION, "pacing": self.clock.pacing, "seed": self.seed, "first_sample": first}
            about["tail_bytes"] = len(tail)
            return Snapshot(
                tick=self.tick, meta={**meta, **about}, state=state, buffers=np.concatenate([tail, buffers])
            )

    def restore(self, meta: Mapping[str, Any], state: npt.NDArray[np.float64], buffers: npt.NDArray[np.uint8]) -> None:
        """Go on from a snapshot. The log keeps what it has from before the snapshot's tick, else its three seconds.

        Raises:
            InvalidInputError: a snapshot of another scene or character, or a damaged one; nothing is changed.
        """
        with self._lock:
            self._check_open()
            tail, rest = split_buffers(meta, buffers)
            backup = self._simulation.snapshot()
            try:
                self._simulation.restore(meta, np.asarray(state), rest)
            except InvalidInputError as error:
                self._simulation.restore(*backup)
                raise InvalidInputError(f"the snapshot is damaged: {error}", field="buffers") from error
            first = int(meta["first_sample"])
            if not self._recorder.first_sample <= first <= self._recorder.next_sample:
                self._recorder.begin_at(first)
            self._recorder.truncate(first)
            self._log(tail)
            self.seed = int(meta["seed"])
            self._recover()
            self._last_good = self._simulation.snapshot()

    def close(self) -> None:
        """Forget the log; later calls raise ConflictError."""
        with self._lock:
            self.closed = True
            self._recorder.close()

    @property
    def recorder(self) -> Recorder:
        """The log."""
        return self._recorder

    # --- inside, the lock is held ---

    def _check_open(self) -> None:
        if self.closed:
            raise ConflictError(f"character {self.character_id!r} was closed", field="character_id")

    def _recover(self) -> None:
        """Go on after a failure: a tracker that failed is asked again."""
        self._failure = None
        self._simulation.driver.resume()

    def _log(self, samples: Samples) -> None:
        kept = {n: a.astype("<f4") if a.dtype.kind == "f" else a.astype("|u1") for n, a in samples.items()}
        self._recorder.append(kept)
        self._last = {name: array[-1] for name, array in kept.items()}
        self._last["contact_impulse_ns"] = kept["contact_impulse_ns"][-SAMPLES_A_TICK:].sum(axis=0)

    def _last_row(self) -> Samples:
        return self._last

    def _place(self, xy_w_m: Xy | None, heading_rad: float | None) -> tuple[tuple[float, float], float]:
        row = self._last_row()
        if xy_w_m is None:
            x, y = (float(v) for v in row["body_pos_w_m"][0, :2])
            xy_w_m = (x, y)
        if heading_rad is None:
            heading_rad = float(heading_of(matrix_from_quat(row["body_quat_w"][0])[:, 0]))
        return xy_w_m, heading_rad

    def _stand_up(self, xy_w_m: Xy, heading_rad: float) -> None:
        self._simulation.reset(xy_w_m, heading_rad)
        self._log_jump()

    def _log_jump(self, kept: Samples | None = None) -> None:
        """Log the state after a reset: it replaces the sample of its tick and fills ticks the clock jumped over.

        Args:
            kept: arrays (1, ...) of the replaced sample that still hold.
        """
        self._recorder.truncate(min(self._recorder.next_sample, self.tick * SAMPLES_A_TICK))
        missing = self.tick * SAMPLES_A_TICK + 1 - self._recorder.next_sample
        sample = {**self._simulation.sample(), **(kept or {})}
        self._log({name: np.repeat(array, missing, axis=0) for name, array in sample.items()})
        self._last_good = self._simulation.snapshot()

    def _fail(self, reason: str) -> None:
        """Write the last sound state for replay, stand the character up where it was, and say so."""
        failed_tick, again = self._simulation.tick, self._failure is not None
        dumped = (
            "as before"
            if again
            else dump_state(self._dump_dir, self.character_id, self._last_good, failed_tick, reason)
        )
        log.error("%s: %s (%s)", self.character_id, reason, dumped)
        self._failure = f"{reason}; character reset; state for replay: {dumped}"
        try:
            self._simulation.tick = self._recorder.next_sample // SAMPLES_A_TICK
            self._stand_up(*self._place(None, None))
        except Exception as error:  # the reason must be seen even if nothing can be mended
            log.exception("%s cannot be reset", self.character_id)
            self._failure = f"{reason}; and it cannot be reset: {type(error).__name__}: {error}"
