"""The jobs of an evaluation on a Ray cluster (extra `ray`): an actor a pair, spread over the nodes.

Every node has motionloop installed, in the same version and with the same weights; what differs is refused. Processor
and wheels are the nodes' own: where they differ, so do the last bits of a plan.
"""

from __future__ import annotations

import asyncio
import importlib.util
from collections import Counter
from collections.abc import Awaitable, Callable, Sequence
from typing import Any, TypeVar

from orchestrator.core.services import Services
from orchestrator.core.supervise import Say
from orchestrator.evaluation.executor import Answering, Executor, Pairing
from shared.errors import IncompatiblePeerError, InvalidInputError, UnavailableError

Argument = TypeVar("Argument")
Result = TypeVar("Result")


class Workplace:
    """A pair on the node where it is made, and its clients; a Ray actor.

    Args:
        pairing: how the pair is started.
    """

    def __init__(self, pairing: Pairing):
        self._pairing = pairing
        self._stack = pairing.stack()
        self._services: Services | None = None

    async def open(self) -> Answering:
        """Start the pair."""
        self._services = await self._pairing.connect(self._stack)
        return Answering.of(self._services, self._pairing)

    async def run(self, job: Callable[[Services, Any], Awaitable[Any]], argument: Any) -> Any:
        """One job."""
        if self._services is None:
            raise UnavailableError("this pair was not started")
        return await job(self._services, argument)

    async def close(self) -> None:
        """End the pair."""
        if self._services is not None:
            await self._services.close()
        self._stack.stop()


class RayCluster(Executor):
    """Pairs on the nodes of a Ray cluster.

    A node that is lost takes its pairs along; their jobs are done again by the others.

    Args:
        pairing: how each pair is started; files of weights are the nodes' own.
        pairs: how many, each with a core of its own.
        parallel: jobs at once, over all pairs.
        address: of the cluster: HOST:PORT, or `auto` for the one of this machine; None makes one of this machine.
        say: told what happens, for people.

    Raises:
        InvalidInputError: ray is not installed.
    """

    def __init__(self, pairing: Pairing, pairs: int, parallel: int, address: str | None = None, say: Say | None = None):
        if importlib.util.find_spec("ray") is None:
            raise InvalidInputError(
                "ray is not installed; try: pip install 'motionloop[ray]'", field="executor", allowed="local"
            )
        self._pairing = pairing
        self._wanted = pairs
        self._parallel = parallel
        self._address = address
        self._say = say or (lambda line: None)
        self._actors: list[Any] = []
        self._busy: Counter[Any] = Counter()

    def __exit__(self, *raised: object) -> None:
        import ray

        if ray.is_initialized():
            ray.shutdown()

    async def open(self) -> Answering:
        """Join the cluster, start a pair for each actor, and see that all are the same."""
        import ray

        try:
            ray.init(address=self._address, log_to_driver=False, include_dashboard=False if not self._address else None)
        except ConnectionError as error:
            raise UnavailableError(f"no Ray cluster at {self._address}: {error}") from error
        cores = int(ray.cluster_resources().get("CPU", 0))
        if cores < self._wanted:
            raise InvalidInputError(
                f"the cluster has {cores} cores, a pair takes one", field="jobs", allowed=f"1 to {cores}"
            )
        each = -(-self._parallel // self._wanted)
        remote = ray.remote(Workplace).options(
            num_cpus=1, scheduling_strategy="SPREAD", max_concurrency=each + 1, max_restarts=0
        )
        self._actors = [remote.remote(self._pairing) for _ in range(self._wanted)]
        answering: list[Answering] = list(await asyncio.gather(*(actor.open.remote() for actor in self._actors)))
        self._say(f"{self._wanted} pairs on {len(ray.nodes())} nodes")
        for other in answering[1:]:
            if other != answering[0]:
                raise IncompatiblePeerError(
                    f"the nodes do not run the same: {answering[0].weights} on one, {other.weights} on another"
                )
        return answering[0]

    async def run(
        self,
        job: Callable[[Services, Argument], Awaitable[Result]],
        arguments: Sequence[Argument],
        done: Callable[[Argument, Result], None],
    ) -> None:
        """Give each job to the pair with the fewest."""
        gate = asyncio.Semaphore(self._parallel)

        async def one(argument: Argument) -> None:
            async with gate:
                result = await self._somewhere(job, argument)
            done(argument, result)

        async with asyncio.TaskGroup() as group:
            for argument in arguments:
                group.create_task(one(argument))

    async def _somewhere(self, job: Callable[[Services, Argument], Awaitable[Result]], argument: Argument) -> Result:
        from ray.exceptions import ActorDiedError, ActorUnavailableError

        while self._actors:
            actor = min(self._actors, key=self._busy.__getitem__)
            self._busy[actor] += 1
            try:
                result: Result = await actor.run.remote(job, argument)
                return result
            except (ActorDiedError, ActorUnavailableError):
                if actor in self._actors:
                    self._actors.remove(actor)
                    self._say(f"a pair was lost, {len(self._actors)} left; its jobs are done again")
            finally:
                self._busy[actor] -= 1
        raise UnavailableError("all nodes of the cluster were lost")

    async def close(self) -> None:
        """End the pairs that are left."""
        await asyncio.gather(*(actor.close.remote() for actor in self._actors), return_exceptions=True)
