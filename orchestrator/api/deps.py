"""What routes need, as dependency aliases."""

from __future__ import annotations

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


Core = Annotated[Orchestrator, Depends(_orchestrator)]
CharacterId = Annotated[UUID, Path(description="Id of a character")]
EpisodeId = Annotated[UUID, Path(description="Id of an episode")]
