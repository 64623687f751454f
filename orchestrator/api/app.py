"""The HTTP application: one Orchestrator behind the routes."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator
from typing import Any

from fastapi import Depends, FastAPI

from orchestrator.api import catalogue, characters, episodes, motion, objects, page, problems, replay, services, stream
from orchestrator.api.access import Tokens, check_request
from orchestrator.api.headers import SafeHeaders
from orchestrator.api.health import HealthWatch
from orchestrator.api.hosts import HostGuard
from orchestrator.api.limits import Limiter, Limits
from orchestrator.api.metrics import OrchestratorMetrics
from orchestrator.api.settings import OrchestratorSettings
from orchestrator.api.tracing import Tracing
from orchestrator.core.manager import Orchestrator
from orchestrator.core.scenes import Scenes
from orchestrator.core.services import Services, Slot, connect
from orchestrator.store.choice import open_store
from shared.errors import UnavailableError
from shared.protocol.security import CurveKeys, load_curve_keys
from shared.protocol.transport import Kind

VERSION = "0.1.0"
SPARES_S = 15.0
"""So long the start waits for all spare trackers together: one that is down holds nothing up."""


async def connect_patiently(
    endpoint: str, kind: Kind, plugin: str | None, curve: CurveKeys | None, timeout_s: float
) -> Slot:
    """Wait for a service that is still starting; raises UnavailableError when it never comes."""
    until = time.monotonic() + timeout_s
    while True:
        try:
            return await connect(endpoint, kind, plugin, curve, timeout_s=min(5.0, max(until - time.monotonic(), 0.1)))
        except UnavailableError:
            if time.monotonic() >= until:
                raise
            await asyncio.sleep(0.2)


async def open_orchestrator(settings: OrchestratorSettings) -> Orchestrator:
    """Connect to both services and open the store. A spare tracker that is not there is taken in once it is."""
    curve = None if settings.curve_dir is None else load_curve_keys(settings.curve_dir, "client")
    limit = settings.connect_timeout_s
    planner = await connect_patiently(settings.planner, "planner", settings.planner_plugin, curve, limit)
    try:
        tracker = await connect_patiently(settings.tracker, "tracker", settings.tracker_plugin, curve, limit)
    except BaseException:
        await planner.client.close()
        raise
    services = Services(planner, tracker, Scenes(settings.scenes), rescue_s=settings.rescue_s)
    try:
        await _take_spares_in(services, settings, curve)
        return await _open_on(services, settings, curve)
    except BaseException:
        await services.close()
        raise


async def _take_spares_in(services: Services, settings: OrchestratorSettings, curve: CurveKeys | None) -> None:
    until = time.monotonic() + min(SPARES_S, settings.connect_timeout_s)
    for endpoint in settings.spare_trackers:
        left_s = max(until - time.monotonic(), 0.5)
        try:
            services.spares.append(await connect_patiently(endpoint, "tracker", settings.tracker_plugin, curve, left_s))
        except UnavailableError:
            services.expect(endpoint, settings.tracker_plugin, curve)


async def _open_on(services: Services, settings: OrchestratorSettings, curve: CurveKeys | None) -> Orchestrator:
    url = None if settings.store is None else settings.store.get_secret_value()
    store = await asyncio.to_thread(open_store, settings.data_dir, url)
    core = Orchestrator(services, store, settings.max_running, curve, settings.unwritten_mb)
    await core.recover()
    return core


def create_app(settings: OrchestratorSettings, opened: Orchestrator | None = None) -> FastAPI:
    """The app. What it serves is `opened`, or opened when it starts; it is closed when the app ends."""

    @contextlib.asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        core = opened if opened is not None else await open_orchestrator(settings)
        app.state.orchestrator = core
        app.state.health = HealthWatch(core)
        app.state.metrics = OrchestratorMetrics(core)
        try:
            yield
        finally:
            await core.close()

    app = FastAPI(
        title="motionloop",
        version=VERSION,
        summary="Text- and target-driven physical characters",
        lifespan=lifespan,
    )
    app.state.orchestrator = None
    app.state.settings = settings
    app.state.tokens = Tokens(settings)
    problems.install(app)
    limits = Limits(settings.max_body_bytes, settings.max_rate_per_s, settings.max_requests, settings.max_streams)
    app.add_middleware(Limiter, limits=limits)
    if settings.token is None or settings.allowed_hosts:
        app.add_middleware(HostGuard, allowed=(settings.host, *settings.allowed_hosts))
    app.add_middleware(SafeHeaders)
    app.add_middleware(Tracing)  # added last, it is the outermost: what the others turn away is traced too
    guarded: list[Any] = [Depends(check_request)]
    app.include_router(characters.router, dependencies=guarded)
    app.include_router(episodes.router, dependencies=guarded)
    app.include_router(objects.router, dependencies=guarded)
    app.include_router(motion.router, dependencies=guarded)
    app.include_router(replay.router, dependencies=guarded)
    app.include_router(services.router, dependencies=guarded)
    app.include_router(catalogue.router, dependencies=guarded)
    app.include_router(stream.router)
    app.include_router(services.health_router)
    page.install(app)
    return app
