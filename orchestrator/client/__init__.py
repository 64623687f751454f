"""Typed, light HTTP client: needs httpx and pydantic only."""

from __future__ import annotations

from orchestrator.client.client import MotionLoopClient, ServerProblem
from orchestrator.client.models import CharacterInfo, EpisodeInfo, EventInfo, StateInfo, TaskInfo

__all__ = [
    "CharacterInfo",
    "EpisodeInfo",
    "EventInfo",
    "MotionLoopClient",
    "ServerProblem",
    "StateInfo",
    "TaskInfo",
]
