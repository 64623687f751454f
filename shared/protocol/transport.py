"""The transport in one import: server, clients, state frames.

Serve (handlers run on worker threads; those of one character in order, never two at once)::

    def step(envelope: Envelope, message: Step) -> StateFrame:          # raise MotionLoopError to refuse
        return characters[envelope.character_id].step(message.ticks)

    def plan(envelope: Envelope, message: PlanRequest) -> Future[Message]:   # or a Future: frees the worker
        return batcher.submit(message)

    server = ServiceServer(
        "tcp://127.0.0.1:0",                       # ipc://PATH; inproc://NAME with a shared context=
        {Step: step, PlanRequest: plan, Health: health},
        welcome=lambda hello: Welcome(service="tracker", version="0.1.0", instance_id="filled-in",
                                      default_plugin="pd", plugins=[spec.model_dump(mode="json")],
                                      state_endpoint=publisher.endpoint),
        workers=4,
    ).start()
    server.endpoint                                # tcp://127.0.0.1:40123
    server.stop()

Ask, blocking or in asyncio (the handshake happens by itself before the first request, and again after the service was
restarted; `connect()` does it now and returns the Welcome)::

    with ServiceClient(server.endpoint, "tracker") as client:
        frame = client.ask(Step(ticks=3), StateFrame, character_id, timeout_s=2.0)
        reply = client.request(Observe(), character_id)

    async with AsyncServiceClient(server.endpoint, "planner") as client:
        plan = await client.ask(request, Plan, character_id, timeout_s=0.5)

Both raise the error that the service's ErrorReply carries (shared/errors.py, by `code`), DeadlineError when no reply
came in time, UnavailableError when nobody is there to shake hands with, IncompatiblePeerError when the wrong one is.
`client.restarts` counts the restarts of the service that were noticed.

Watch::

    publisher = StatePublisher("tcp://127.0.0.1:0")                     # publisher.publish(frame), any thread
    async for frame in AsyncStateSubscriber(publisher.endpoint, character_id).frames(): ...
    StateSubscriber(publisher.endpoint).latest(timeout_s=1.0)           # {character id: newest frame}

Contexts made here are ended with linger 0; a context that was passed in is the caller's to end, after everything on it
was closed.
"""

from __future__ import annotations

from shared.protocol.client import AsyncServiceClient, Kind, ServiceClient
from shared.protocol.pubsub import AsyncStateSubscriber, StatePublisher, StateSubscriber
from shared.protocol.server import Handler, ServiceServer

__all__ = [
    "AsyncServiceClient",
    "AsyncStateSubscriber",
    "Handler",
    "Kind",
    "ServiceClient",
    "ServiceServer",
    "StatePublisher",
    "StateSubscriber",
]
