"""Typed clients of the HTTP API, blocking and asyncio: need numpy, pydantic, httpx and websockets only."""

from __future__ import annotations

from orchestrator.client.aio import AsyncCharacter, AsyncClient, AsyncEpisode
from orchestrator.client.errors import ServerProblem
from orchestrator.client.models import CharacterInfo, EpisodeInfo, PlanGhost, State
from orchestrator.client.motion import Motion
from orchestrator.client.sync import Character, Client, Episode
from orchestrator.rest import Event, ObjectState, ServiceInfo, ServicesInfo, TaskResult

__all__ = [
    "AsyncCharacter",
    "AsyncClient",
    "AsyncEpisode",
    "Character",
    "CharacterInfo",
    "Client",
    "Episode",
    "EpisodeInfo",
    "Event",
    "Motion",
    "ObjectState",
    "PlanGhost",
    "ServerProblem",
    "ServiceInfo",
    "ServicesInfo",
    "State",
    "TaskResult",
]
