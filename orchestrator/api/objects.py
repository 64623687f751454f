"""A character's scene and its objects: what is there, where it is now, and moving it."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Body, Path
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, model_validator

from orchestrator.api.deps import CharacterId, Core, EpisodeId
from orchestrator.api.problems import RESPONSES
from orchestrator.rest import ObjectState
from shared.errors import InvalidInputError, NotFoundError
from shared.protocol.messages import SetObject, StateFrame
from shared.scenes.schema import Scene

router = APIRouter(prefix="/v1", tags=["objects"], responses=RESPONSES)

Metres = Annotated[FiniteFloat, Field(ge=-1000, le=1000)]
Rate = Annotated[FiniteFloat, Field(ge=-100, le=100)]
ObjectName = Annotated[str, Path(pattern=r"^[a-z][a-z0-9_]{0,31}$", description="as in the scene")]
_CALLED_HERE = {
    "position_w_m": "position_m",
    "quat_w": "rotation_wxyz",
    "linvel_w_mps": "velocity_mps",
    "angvel_w_radps": "angular_velocity_radps",
}
"""The tracker's names of the fields of `ObjectBody`."""
_MOVES: dict[str, Any] = {
    "throw": {"summary": "A ball at the chest", "value": {"position_m": [3, 0, 1.2], "velocity_mps": [-6, 0, 2]}},
    "put": {"summary": "Somewhere else", "value": {"position_m": [1.5, 0.5, 0]}},
}


class ObjectBody(BaseModel):
    """Where an object of the scene should be, and how it should move; what is left out stays.

    A fixed object takes no velocity; a hinged one takes a turn and a rate about its axis only.
    """

    model_config = ConfigDict(extra="forbid")
    position_m: tuple[Metres, Metres, Metres] | None = None
    rotation_wxyz: tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat] | None = None
    velocity_mps: tuple[Rate, Rate, Rate] | None = None
    angular_velocity_radps: tuple[Rate, Rate, Rate] | None = None

    @model_validator(mode="after")
    def _says_something(self) -> ObjectBody:
        if all(getattr(self, name) is None for name in type(self).model_fields):
            raise ValueError("nothing is said of the object")
        if self.rotation_wxyz is not None and sum(part * part for part in self.rotation_wxyz) < 1e-6:
            raise ValueError("rotation_wxyz is no rotation")
        return self


def states_of(state: StateFrame) -> list[ObjectState]:
    """All objects of a state."""
    columns = (state.object_pos_w_m, state.object_quat_w, state.object_linvel_w_mps, state.object_angvel_w_radps)
    rows = [[tuple(round(float(v), 5) for v in row) for row in column] for column in columns]
    return [
        ObjectState(name=name, position_m=p, rotation_wxyz=q, velocity_mps=v, angular_velocity_radps=w)
        for name, p, q, v, w in zip(state.objects, *rows, strict=True)
    ]


class ObjectList(BaseModel):
    """The objects of a character's scene, now."""

    tick: int
    items: list[ObjectState]


@router.get("/characters/{character_id}/scene")
async def character_scene(core: Core, character_id: CharacterId) -> Scene:
    """The character's scene as its seed made it: nothing is left to draw."""
    return _there(core.character(str(character_id)).scene)


@router.get("/episodes/{episode_id}/scene")
async def episode_scene(core: Core, episode_id: EpisodeId) -> Scene:
    """The scene of an episode, running or over, as its seed made it."""
    return _there(await core.episode_scene(str(episode_id)))


@router.get("/characters/{character_id}/objects")
async def objects(core: Core, character_id: CharacterId) -> ObjectList:
    """Where the objects are now and how they move."""
    state = core.character(str(character_id)).state
    return ObjectList(tick=state.tick, items=states_of(state))


@router.put("/characters/{character_id}/objects/{name}")
async def move_object(
    core: Core, character_id: CharacterId, name: ObjectName, body: Annotated[ObjectBody, Body(openapi_examples=_MOVES)]
) -> ObjectState:
    """Put an object somewhere, at once, and give it a velocity."""
    request = SetObject(
        name=name,
        position_w_m=body.position_m,
        quat_w=body.rotation_wxyz,
        linvel_w_mps=body.velocity_mps,
        angvel_w_radps=body.angular_velocity_radps,
    )
    try:
        state = await core.character(str(character_id)).set_object(request)
    except InvalidInputError as error:
        field = _CALLED_HERE.get(error.field or "", error.field)
        allowed = ", ".join(_CALLED_HERE.get(word, word) for word in (error.allowed or "").split(" and "))
        raise InvalidInputError(error.message, field=field, allowed=allowed or None) from error
    return next(item for item in states_of(state) if item.name == name)


def _there(scene: Scene | None) -> Scene:
    if scene is None:
        raise NotFoundError("only the tracker knows this scene, by its name", field="scene")
    return scene
