"""Scenes as data: YAML files checked by schema, so that users add objects without code.

::

    name: bag
    bodies:
      - name: bag
        shape: cylinder
        size_m: [0.2, 0.935]        # box: half sizes; cylinder, capsule: radius, half length; sphere: radius
        mass_kg: 63                 # absent: fixed in the world
        position_w_m: [1.5, 0, 0.935]
        heading_deg: 0
    marks:
      front: {position_w_m: [0, 0, 0], heading_deg: 0}
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Annotated, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError, model_validator

from shared.errors import InvalidInputError, NotFoundError

Vec3 = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,31}$")]
_SIZES = {"box": 3, "cylinder": 2, "capsule": 2, "sphere": 1}

LIBRARY = Path(__file__).parent / "library"


class _Data(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class SceneBody(_Data):
    """One object, see the module's docstring for its fields."""

    name: Name
    shape: Literal["box", "cylinder", "capsule", "sphere"]
    size_m: Annotated[tuple[Annotated[float, Field(gt=0, le=50)], ...], Field(min_length=1, max_length=3)]
    mass_kg: Annotated[float, Field(gt=0, le=10_000)] | None = None
    position_w_m: Vec3
    heading_deg: FiniteFloat = 0.0
    friction: Annotated[float, Field(ge=0, le=5)] = 0.8

    @model_validator(mode="after")
    def _sizes_fit(self) -> SceneBody:
        if len(self.size_m) != _SIZES[self.shape]:
            raise ValueError(f"{self.shape} takes {_SIZES[self.shape]} sizes, got {len(self.size_m)}")
        return self


class Mark(_Data):
    """A named place, e.g. a seat's centre or front."""

    position_w_m: Vec3
    heading_deg: FiniteFloat = 0.0


class Scene(_Data):
    """A floor at z = 0 with objects and marks on it."""

    name: Name
    bodies: Annotated[tuple[SceneBody, ...], Field(max_length=64)] = ()
    marks: dict[Name, Mark] = {}

    @model_validator(mode="after")
    def _names_differ(self) -> Scene:
        names = [body.name for body in self.bodies]
        if len(set(names)) != len(names):
            raise ValueError(f"two bodies share a name: {', '.join(sorted(names))}")
        return self


def parse_scene(text: str) -> Scene:
    """Scene from YAML text; raises InvalidInputError naming the first field that is wrong."""
    try:
        data = yaml.safe_load(text)
        return Scene.model_validate(data)
    except yaml.YAMLError as error:
        raise InvalidInputError(f"the scene is not YAML: {error}", field="scene", allowed="YAML") from error
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join(("scene", *(str(part) for part in first["loc"])))
        raise InvalidInputError(f"the scene is wrong: {first['msg']}", field=field) from error


def scene_names(folder: Path = LIBRARY) -> list[str]:
    """Names of the scenes in a folder."""
    return sorted(path.stem for path in folder.glob("*.yaml"))


@cache
def load_scene(name: str, folder: Path = LIBRARY) -> Scene:
    """Scene by name; raises NotFoundError listing the known ones."""
    names = scene_names(folder)
    if name not in names:
        raise NotFoundError(f"unknown scene {name!r}", field="scene", allowed=", ".join(names))
    return parse_scene((folder / f"{name}.yaml").read_text(encoding="utf-8"))
