"""/v1/services, health and metrics."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi import APIRouter, Body, Depends, Request, Response
from fastapi.exceptions import HTTPException
from prometheus_client import CONTENT_TYPE_LATEST, generate_latest

from orchestrator.api.access import check_request
from orchestrator.api.deps import Core
from orchestrator.api.health import HealthWatch
from orchestrator.api.metrics import OrchestratorMetrics
from orchestrator.api.models import HealthBody, SwapBody
from orchestrator.api.problems import RESPONSES, problem_response
from orchestrator.api.settings import OrchestratorSettings
from orchestrator.rest import Problem, ServiceInfo, ServicesHealth, ServicesInfo
from shared.errors import MotionLoopError
from shared.protocol.control import Health, HealthReport

router = APIRouter(prefix="/v1/services", tags=["services"], responses=RESPONSES)
health_router = APIRouter(tags=["health"])

HEALTH_TIMEOUT_S = 2.0
_SWAPS: dict[str, Any] = {
    "plugin": {"summary": "Another plug-in of the same service", "value": {"plugin": "stand"}},
    "endpoint": {"summary": "Another service", "value": {"endpoint": "tcp://127.0.0.1:5701", "plugin": "dip"}},
}


@router.get("")
async def get(core: Core) -> ServicesInfo:
    """What planner and tracker are in use, and what else they offer."""
    return ServicesInfo.model_validate(core.service_report())


@router.get("/health")
async def health(core: Core, request: Request) -> ServicesHealth:
    """How planner and tracker are. Always 200: a service that is away is an answer and not an error."""
    watch: HealthWatch = request.app.state.health
    return await watch.look()


@router.put("/{kind}")
async def put(
    core: Core,
    request: Request,
    kind: Literal["planner", "tracker"],
    body: Annotated[SwapBody, Body(openapi_examples=_SWAPS)],
) -> ServiceInfo:
    """Exchange a service or plug-in while it runs; an unfit one is refused and the old one stays."""
    settings: OrchestratorSettings = request.app.state.settings
    if body.endpoint is not None and not settings.may_swap_to(body.endpoint):
        raise HTTPException(403, "this server may not swap to this endpoint: MOTIONLOOP_SWAP_ENDPOINTS lists where to")
    return ServiceInfo.model_validate(await core.swap(kind, body.endpoint, body.plugin))


@health_router.get("/healthz")
async def healthz() -> HealthBody:
    """The process is alive."""
    return HealthBody(status="ok")


@health_router.get("/readyz", response_model=HealthBody, responses={503: {"model": Problem}})
async def readyz(core: Core) -> HealthBody | Response:
    """Both services answer."""
    found: dict[str, str] = {}
    for kind, slot in (("planner", core.services.planner), ("tracker", core.services.tracker)):
        try:
            report = await slot.client.ask(Health(), HealthReport, timeout_s=HEALTH_TIMEOUT_S)
            found[kind] = report.status
        except MotionLoopError as error:
            found[kind] = error.message
    missing = [kind for kind, status in found.items() if status not in ("ok", "degraded")]
    if missing:
        detail = "; ".join(f"{kind}: {found[kind]}" for kind in missing)
        return problem_response(
            Problem(title="not ready", status=503, detail=detail, code="unavailable", retryable=True, field=missing[0])
        )
    return HealthBody(status="ok", services=found)


@health_router.get("/metrics", response_class=Response, dependencies=[Depends(check_request)])
async def metrics(core: Core, request: Request) -> Response:
    """Prometheus text."""
    counted: OrchestratorMetrics = request.app.state.metrics
    return Response(generate_latest(counted.registry), media_type=CONTENT_TYPE_LATEST)
