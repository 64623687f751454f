"""Environments spread over processes: what follows from physics is numpy, which threads of one process hardly share.

Everything that a tick changes lies in memory that all processes map. The parent holds the failure rates and draws the
seed of every tick, so that a training that was stopped and one that was not do the same.
"""

from __future__ import annotations

import atexit
import mmap
import multiprocessing
import signal
from collections.abc import Sequence
from contextlib import suppress
from math import prod
from multiprocessing.connection import Connection
from multiprocessing.context import ForkProcess
from typing import Any

import numpy as np
import numpy.typing as npt

from shared.errors import SimulationError
from tracker_service.simulation.humanoid import Humanoid
from tracker_service.training.dataset import ReferenceSet
from tracker_service.training.env import StepResult, TrackingEnv
from tracker_service.training.env_settings import EnvSettings
from tracker_service.training.sampling import FailureTable

F32 = npt.NDArray[np.float32]
Arrays = dict[str, npt.NDArray[Any]]
Ended = tuple[int, int, int, bool]
_KEPT = ("state", "clip", "time", "begun", "age", "jump_m", "previous_action")
_TOLD = ("observation", "final_observation", "reward", "terminated", "truncated", "exploded", "error_m")


def shared_array(shape: Sequence[int], dtype: npt.DTypeLike) -> npt.NDArray[Any]:
    """Zeros in memory that processes forked from this one share with it."""
    size = prod(shape) * np.dtype(dtype).itemsize
    return np.frombuffer(mmap.mmap(-1, max(size, 1)), dtype, count=prod(shape)).reshape(shape)


class _Notes(FailureTable):
    """The parent's failure table in a child: it draws as that does, and keeps what is to be noted."""

    def __init__(self, table: FailureTable):
        self.__dict__.update(table.__dict__)
        self.ended: list[Ended] = []

    def note(self, clip: int, begin_tick: int, end_tick: int, failed: bool) -> None:
        self.ended.append((clip, begin_tick, end_tick, failed))


class ProcessEnv(TrackingEnv):
    """`TrackingEnv` whose ticks are done by forked processes, each with a part of the environments.

    To be made before a graphics card is used: what uses one cannot be forked.
    """

    def __init__(self, human: Humanoid, references: ReferenceSet, settings: EnvSettings, seed: int):
        super().__init__(human, references, settings.model_copy(update={"threads": 1}), seed)
        b = settings.envs
        shapes: dict[str, tuple[tuple[int, ...], npt.DTypeLike]] = {
            "action": ((b, self.hinges), np.float32), "disturbed": ((b,), np.bool_),
            **{name: ((b, self.observation_size), np.float32) for name in ("observation", "final_observation")},
            **{name: ((b,), np.float32) for name in ("reward", "error_m")},
            **{name: ((b,), np.bool_) for name in ("terminated", "truncated", "exploded")},
        }  # fmt: skip
        for name in _KEPT:
            array = getattr(self, name)
            shapes[name] = array.shape, array.dtype
        self._common: Arrays = {name: shared_array(shape, dtype) for name, (shape, dtype) in shapes.items()}
        self._take_back()
        for name in ("rate", "visits", "kin_rate"):
            values = getattr(self.failures, name)
            kept = shared_array(values.shape, values.dtype)
            kept[:] = values
            setattr(self.failures, name, kept)
        edges = np.linspace(0, b, min(settings.processes, b) + 1).astype(int).tolist()
        context = multiprocessing.get_context("fork")
        self._children: list[tuple[ForkProcess, Connection]] = []
        atexit.register(self.close)  # children outlive the terminate() of a parent that ends by an exception
        for first, last in zip(edges[:-1], edges[1:], strict=True):
            ours, theirs = context.Pipe()
            part = settings.model_copy(update={"envs": last - first, "threads": 1, "processes": 1})
            inherited = [pipe for _, pipe in self._children] + [ours]
            arguments = (human, references, part, self._common, slice(first, last), self.failures, theirs, inherited)
            child = context.Process(target=_serve, args=arguments, daemon=True)
            child.start()
            theirs.close()
            self._children.append((child, ours))

    def close(self) -> None:
        """End the processes. Safe to call twice."""
        children, self._children = self._children, []
        if not children:
            return
        for _, pipe in children:
            with suppress(ConnectionError):  # one that has died
                pipe.send(("end", 0))
        for child, pipe in children:
            child.join()
            pipe.close()
        atexit.unregister(self.close)
        super().close()

    def reset_all(self) -> F32:
        """Begin a new episode everywhere; first observations (B, D)."""
        self._ask("reset")
        return np.asarray(self._common["observation"].copy())

    def step(self, action: F32) -> StepResult:
        """As `TrackingEnv.step`."""
        self._common["action"][:] = action
        self._ask("step")
        told = {name: self._common[name].copy() for name in _TOLD}
        return StepResult(**told, disturbed=np.flatnonzero(self._common["disturbed"]))

    def moved(self) -> None:
        """Tell that arrays were changed, or others put in their place."""
        self._take_back()
        self._ask("pull")

    def _take_back(self) -> None:
        """What stands in the attributes, into the shared arrays that then stand there."""
        for name in _KEPT:
            self._common[name][:] = getattr(self, name)
            setattr(self, name, self._common[name])
        self._bodies = None

    def _ask(self, order: str) -> None:
        seed = int(self.rng.integers(2**62)) if order != "pull" else 0
        try:
            for _, pipe in self._children:
                pipe.send((order, seed))
            told = [pipe.recv() for _, pipe in self._children]
        except (EOFError, ConnectionError) as error:
            raise SimulationError("a process of the environments has died; its own error is above") from error
        # Noted in one order, and not before the last child has drawn from the same table.
        for notes in told:
            for ended in notes:
                self.failures.note(*ended)
        self._bodies = None


def _serve(
    human: Humanoid, references: ReferenceSet, settings: EnvSettings, shared: Arrays, rows: slice,
    table: FailureTable, pipe: Connection, inherited: list[Connection],
) -> None:  # fmt: skip
    """A child's life: its part of the environments, one order after another."""
    for end in inherited:
        end.close()  # the parent's: as long as somebody holds one, nobody hears that the parent is gone
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # the parent hears them, and ends its children
    env = TrackingEnv(human, references, settings, 0)
    env.failures = notes = _Notes(table)
    try:
        while True:
            order, seed = pipe.recv()
            if order == "end":
                break
            if order == "pull":
                for name in _KEPT:
                    setattr(env, name, shared[name][rows].copy())
                env.moved()
            else:
                env.rng = np.random.default_rng([seed, rows.start])
                _do(env, order, shared, rows)
                for name in _KEPT:
                    shared[name][rows] = getattr(env, name)
            pipe.send(notes.ended)
            notes.ended = []
    except (EOFError, ConnectionError):  # the parent is gone
        pass
    env.close()


def _do(env: TrackingEnv, order: str, shared: Arrays, rows: slice) -> None:
    if order == "reset":
        shared["observation"][rows] = env.reset_all()
        return
    result = env.step(shared["action"][rows])
    for name in _TOLD:
        shared[name][rows] = getattr(result, name)
    disturbed = np.zeros(env.settings.envs, np.bool_)
    disturbed[result.disturbed] = True
    shared["disturbed"][rows] = disturbed
