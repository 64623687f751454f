"""Where the jobs of an evaluation run: each job against one pair of planner and tracker, many pairs at a time.

A job is a function of a module and one argument. It depends on nothing but these, so that it gives the same wherever it
runs and whatever runs beside it: the rows of an evaluation are the same for every executor and any number of pairs.
"""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Self, TypeVar

from orchestrator.core.services import Services, connect
from orchestrator.core.supervise import Say, Stack, StackOptions

ExecutorName = Literal["local", "ray"]
Argument = TypeVar("Argument")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Pairing:
    """How a pair of planner and tracker is started; plain values, which can be told to another machine.

    Attributes:
        planner, tracker: plug-ins; None for the services' own choice.
        threads: of the planner.
        planner_args: more arguments for the planner.
        planner_weights, tracker_weights: files on the machine where the pair is started; None for those that ship.
    """

    planner: str | None = None
    tracker: str | None = None
    threads: int = 1
    planner_args: tuple[str, ...] = ()
    planner_weights: Path | None = None
    tracker_weights: Path | None = None

    def stack(self, say: Say | None = None) -> Stack:
        """The two as processes of this machine, not yet started."""
        planner_args: tuple[str, ...] = ("--threads", str(self.threads), *self.planner_args)
        tracker_args: tuple[str, ...] = ("--max-characters", "64")
        if self.planner_weights is not None:
            planner_args = (*planner_args, "--dip-weights", str(self.planner_weights))
        if self.tracker_weights is not None:
            tracker_args = (*tracker_args, "--weights", str(self.tracker_weights))
        return Stack(StackOptions(planner_args=planner_args, tracker_args=tracker_args), say)

    async def connect(self, stack: Stack) -> Services:
        """Start the processes of `stack` and shake hands with both."""
        planner, tracker = stack.start_services()
        return Services(
            await connect(planner, "planner", self.planner), await connect(tracker, "tracker", self.tracker)
        )


@dataclass(frozen=True)
class Answering:
    """What answers: the specs of the plug-ins in use."""

    planner: dict[str, Any]
    tracker: dict[str, Any]

    @classmethod
    def of(cls, services: Services, pairing: Pairing) -> Answering:
        """Of one pair."""
        return cls(services.planner.spec(pairing.planner), services.tracker.spec(pairing.tracker))

    @property
    def weights(self) -> str:
        """Names, versions and weights, so that rows of other weights are told apart."""
        return ", ".join(
            f"{spec.get('name')} {spec.get('version')} {str(spec.get('weights_sha256'))[:12]}"
            for spec in (self.planner, self.tracker)
        )


class Executor(ABC):
    """Pairs of planner and tracker, and what runs jobs against them; leaving it as a context ends the pairs."""

    def __enter__(self) -> Self:
        return self

    @abstractmethod
    def __exit__(self, *raised: object) -> None: ...

    @abstractmethod
    async def open(self) -> Answering:
        """Start the pairs. Raises MotionLoopError when one does not start or is not as the others."""

    @abstractmethod
    async def run(
        self,
        job: Callable[[Services, Argument], Awaitable[Result]],
        arguments: Sequence[Argument],
        done: Callable[[Argument, Result], None],
    ) -> None:
        """Run `job` for each argument, in any order; `done` is called in this process as each ends."""

    @abstractmethod
    async def close(self) -> None:
        """Let go of the pairs' sockets."""


class LocalProcesses(Executor):
    """Pairs as processes of this machine, driven by this process.

    Args:
        pairing: how each pair is started.
        pairs: how many.
        parallel: jobs at once, over all pairs.
        say: told what happens, for people.
    """

    def __init__(self, pairing: Pairing, pairs: int, parallel: int, say: Say | None = None):
        self._pairing = pairing
        self._stacks = [pairing.stack(say) for _ in range(pairs)]
        self._gate = asyncio.Semaphore(parallel)
        self._pairs: list[Services] = []

    def __exit__(self, *raised: object) -> None:
        for stack in self._stacks:
            stack.stop()

    async def open(self) -> Answering:
        """Start all pairs and shake hands."""
        for stack in self._stacks:
            self._pairs.append(await self._pairing.connect(stack))
        return Answering.of(self._pairs[0], self._pairing)

    async def run(
        self,
        job: Callable[[Services, Argument], Awaitable[Result]],
        arguments: Sequence[Argument],
        done: Callable[[Argument, Result], None],
    ) -> None:
        """Spread the arguments over the pairs, in turn."""

        async def one(place: int, argument: Argument) -> None:
            async with self._gate:
                result = await job(self._pairs[place % len(self._pairs)], argument)
            done(argument, result)

        async with asyncio.TaskGroup() as group:
            for place, argument in enumerate(arguments):
                group.create_task(one(place, argument))

    async def close(self) -> None:
        """Close the sockets of all pairs."""
        for services in self._pairs:
            await services.close()
