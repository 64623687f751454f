"""What routes need, as dependency aliases."""

from __future__ import annotations

import secrets
from typing import Annotated
from uuid import UUID

from fastapi import Depends, Path
from fastapi.exceptions import HTTPException
from starlette.requests import HTTPConnection

from orchestrator.core.manager import Orchestrator


def _orchestrator(connection: HTTPConnection) -> Orchestrator:
    found = connection.app.state.orchestrator
    if not isinstance(found, Orchestrator):
        raise HTTPException(503, "the orchestrator is still starting")
    return found


def check_token(connection: HTTPConnection) -> None:
    """Refuse a request without the bearer token, where one is set."""
    wanted: str | None = connection.app.state.token
    if wanted is None:
        return
    given = connection.headers.get("authorization", "")
    if not secrets.compare_digest(given.encode(), f"Bearer {wanted}".encode()):
        raise HTTPException(401, "a bearer token is needed", headers={"WWW-Authenticate": "Bearer"})


Core = Annotated[Orchestrator, Depends(_orchestrator)]
CharacterId = Annotated[UUID, Path(description="Id of a character")]
EpisodeId = Annotated[UUID, Path(description="Id of an episode")]
