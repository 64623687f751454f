"""/v1/tasks, /v1/scenes and /v1/skeleton: what there is to choose from and how a body is built."""

from __future__ import annotations

import asyncio
from typing import Any

from fastapi import APIRouter
from pydantic import BaseModel

from orchestrator.api.deps import Core
from orchestrator.api.problems import RESPONSES
from orchestrator.core.command import JOINTS
from orchestrator.rest import Point
from shared.motion.skeleton import CANONICAL
from shared.protocol.messages import TICK_HZ
from shared.scenes.schema import Scene
from shared.tasks.factory import KINDS

router = APIRouter(prefix="/v1", tags=["catalogue"], responses=RESPONSES)


class TaskKind(BaseModel):
    """A task that episodes may hold: its type, what it does, and the JSON Schema of its fields."""

    type: str
    description: str
    parameters: dict[str, Any]


class TaskList(BaseModel):
    """All tasks."""

    items: list[TaskKind]


class SceneList(BaseModel):
    """All scenes as their files have them; `wrong` says which files of the server's own folder cannot be read."""

    items: list[Scene]
    wrong: dict[str, str] = {}


class SkeletonBody(BaseModel):
    """Joints by name, in the order of every array of joints; offsets in the T-pose facing +X, metres."""

    id: str
    joints: list[str]
    parents: list[int]
    offsets_m: list[Point]
    rest_positions_m: list[Point]
    height_m: float
    tick_hz: int = TICK_HZ
    target_joints: list[str]


def task_models() -> tuple[type[BaseModel], ...]:
    """The spec classes of all kinds."""
    return tuple(kind.spec for kind in KINDS.values())


@router.get("/tasks")
async def tasks() -> TaskList:
    """The tasks there are, for `POST /v1/episodes`."""
    items = []
    for model in task_models():
        schema = model.model_json_schema()
        described = str(schema.get("description", "")).split("\n\n", 1)[0].replace("`", "")
        items.append(TaskKind(type=str(model.model_fields["type"].default), description=described, parameters=schema))
    return TaskList(items=items)


@router.get("/scenes")
async def scenes(core: Core) -> SceneList:
    """The scenes there are, with their objects and marks."""
    items, wrong = await asyncio.to_thread(core.services.scenes.all)
    return SceneList(items=items, wrong=wrong)


@router.get("/skeleton")
async def skeleton() -> SkeletonBody:
    """The skeleton of every character, and the joints that a target may name."""
    return SkeletonBody(
        id=CANONICAL.id,
        joints=list(CANONICAL.names),
        parents=list(CANONICAL.parents),
        offsets_m=CANONICAL.offsets_m.tolist(),
        rest_positions_m=CANONICAL.rest_positions_m.tolist(),
        height_m=CANONICAL.height_m,
        target_joints=list(JOINTS),
    )
