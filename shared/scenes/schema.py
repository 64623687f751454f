"""Scenes as data: bodies of several primitives, fixed, free or hinged, and named marks; users add objects without code.

::

    name: corner
    bodies:
      - name: table                     # fixed in the world: no mass
        position_w_m: [1.5, 0, 0]
        heading_deg: 90
        parts:
          - {shape: box, size_m: [0.4, 0.6, 0.02], position_b_m: [0, 0, 0.72]}
          - {shape: cylinder, size_m: [0.05, 0.35], position_b_m: [0, 0, 0.35]}
      - {name: ball, shape: sphere, size_m: [0.11], mass_kg: 0.43, position_w_m: [1, 1, 0.11]}   # one part, and free
    marks:
      seat_centre: {body: table, position_b_m: [0, 0, 0.74], heading_deg: 0, half_size_m: [0.4, 0.6]}
      exit: {position_w_m: [4, 0, 0]}

Metres, kilograms, degrees; Z up, the floor is z = 0. A body's own frame (`_b`) lies at `position_w_m`, turned about Z.
`docs/scenes.md` lists every field.
"""

from __future__ import annotations

from math import cos, pi, radians, sin
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, model_validator

Vec3 = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,31}$")]
Shape = Literal["box", "cylinder", "capsule", "sphere"]
Motion = Literal["fixed", "free", "hinged"]
Size = Annotated[float, Field(gt=0, le=50)]
Colour = Annotated[float, Field(ge=0, le=1)]
Factor = Annotated[float, Field(gt=0.1, lt=10)]
Friction = Annotated[float, Field(ge=0, le=5)]
_SIZES: dict[Shape, int] = {"box": 3, "cylinder": 2, "capsule": 2, "sphere": 1}
_SHORT = ("shape", "size_m", "colour")


def _with_short_form(schema: dict[str, Any]) -> None:
    """Let the JSON schema say what the short form of a body may leave out and have instead."""
    schema["required"] = ["name", "position_w_m"]
    numbers = {"type": "array", "items": {"type": "number"}, "minItems": 1, "maxItems": 3}
    schema["properties"] |= {
        "shape": {"enum": list(_SIZES), "description": "short for one part of this shape"},
        "size_m": numbers | {"description": "short for one part of this size"},
        "colour": numbers | {"description": "short for one part of this colour"},
    }


MAX_BODIES, MAX_PARTS = 32, 32


class _Data(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Part(_Data):
    """One primitive of a body.

    Attributes:
        size_m: half sizes of a box; radius and half length of a cylinder or capsule, which lie along their Z; radius of
            a sphere.
        position_b_m: of its centre in the body's frame. rotation_deg: about the body's X, then its Y, then its Z.
        mass_kg: its share of the body's mass; without it the body's mass is spread by volume.
        friction: sliding friction, the body's own by default.
        colour: red, green, blue from 0 to 1.
    """

    shape: Shape
    size_m: Annotated[tuple[Size, ...], Field(min_length=1, max_length=3)]
    position_b_m: Vec3 = (0.0, 0.0, 0.0)
    rotation_deg: Vec3 = (0.0, 0.0, 0.0)
    mass_kg: Annotated[float, Field(gt=0, le=10_000)] | None = None
    friction: Friction | None = None
    colour: tuple[Colour, Colour, Colour] | None = None

    @model_validator(mode="after")
    def _sizes_fit(self) -> Part:
        if len(self.size_m) != _SIZES[self.shape]:
            raise ValueError(f"a {self.shape} takes {_SIZES[self.shape]} sizes, got {len(self.size_m)}")
        return self

    @property
    def volume_m3(self) -> float:
        """Its volume, whatever it overlaps."""
        if self.shape == "box":
            return 8 * self.size_m[0] * self.size_m[1] * self.size_m[2]
        ball = 4 / 3 * pi * self.size_m[0] ** 3
        if self.shape == "sphere":
            return ball
        tube = 2 * pi * self.size_m[0] ** 2 * self.size_m[1]
        return tube + ball if self.shape == "capsule" else tube

    @property
    def quat_b(self) -> tuple[float, float, float, float]:
        """Its turn in the body's frame, wxyz."""
        x, y, z = (radians(angle) / 2 for angle in self.rotation_deg)
        (cx, cy, cz), (sx, sy, sz) = map(cos, (x, y, z)), map(sin, (x, y, z))
        return (  # about Z after about Y after about X
            cx * cy * cz + sx * sy * sz,
            sx * cy * cz - cx * sy * sz,
            cx * sy * cz + sx * cy * sz,
            cx * cy * sz - sx * sy * cz,
        )


class Hinge(_Data):
    """How a hinged body turns: about `axis_b` through `anchor_b_m`, both in its frame at rest.

    Attributes:
        range_deg: lowest and highest angle, 0 being the pose in the file; None turns freely.
        damping: N m s / rad. stiffness: N m / rad back to the pose in the file.
    """

    anchor_b_m: Vec3 = (0.0, 0.0, 0.0)
    axis_b: Vec3 = (0.0, 0.0, 1.0)
    range_deg: tuple[FiniteFloat, FiniteFloat] | None = None
    damping: Annotated[float, Field(ge=0, le=1e4)] = 0.5
    stiffness: Annotated[float, Field(ge=0, le=1e5)] = 0.0

    @model_validator(mode="after")
    def _sound(self) -> Hinge:
        if not any(self.axis_b):
            raise ValueError("axis_b has no direction")
        if self.range_deg is not None and not self.range_deg[0] < self.range_deg[1]:
            raise ValueError("range_deg is lowest, highest")
        return self


class RandomRanges(_Data):
    """What differs from seed to seed; each range is lowest, highest, and the file's own value lies at 0 or 1.

    Attributes:
        position_m: added to the position, along world X and along Y. heading_deg: added to the heading.
        size: factor of all sizes. height: factor of heights in its place.
        mass: factor of the mass. friction: factor of friction.
    """

    position_m: tuple[tuple[FiniteFloat, FiniteFloat], tuple[FiniteFloat, FiniteFloat]] | None = None
    heading_deg: tuple[FiniteFloat, FiniteFloat] | None = None
    size: tuple[Factor, Factor] | None = None
    height: tuple[Factor, Factor] | None = None
    mass: tuple[Factor, Factor] | None = None
    friction: tuple[Factor, Factor] | None = None

    @model_validator(mode="after")
    def _ordered(self) -> RandomRanges:
        pairs = [self.heading_deg, self.size, self.height, self.mass, self.friction, *(self.position_m or ())]
        if any(pair is not None and pair[0] > pair[1] for pair in pairs):
            raise ValueError("a range is lowest, highest")
        return self


class SceneBody(_Data):
    """One object: see the module's docstring. `shape`, `size_m` and `colour` are short for a single part.

    Attributes:
        motion: `fixed` in the world, `free`, or `hinged`; by default hinged with a hinge, free with a mass, else fixed.
        mass_kg: of the whole body; what moves has one.
        friction: sliding friction of its parts. rolling_friction_m: what stops a ball; None: it rolls on.
        ground: a fixed body that counts as floor: steps, ramps, platforms.
        hinge, random: see there.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", json_schema_extra=_with_short_form)
    name: Name
    motion: Motion
    position_w_m: Vec3
    heading_deg: FiniteFloat = 0.0
    parts: Annotated[tuple[Part, ...], Field(min_length=1, max_length=MAX_PARTS)]
    mass_kg: Annotated[float, Field(gt=0, le=10_000)] | None = None
    friction: Friction = 0.8
    rolling_friction_m: Annotated[float, Field(ge=0, le=1)] | None = None
    ground: bool = False
    hinge: Hinge | None = None
    random: RandomRanges | None = None

    @model_validator(mode="before")
    @classmethod
    def _spelt_out(cls, data: Any) -> Any:
        """Fill in what the short form leaves out."""
        if not isinstance(data, dict):
            return data
        data = dict(data)
        short = {key: data.pop(key) for key in _SHORT if key in data}
        if short:
            if "parts" in data:
                raise ValueError(f"either parts or {', '.join(short)}, not both")
            data["parts"] = (short,)
        if "motion" not in data:
            masses = [part.get("mass_kg") for part in data.get("parts") or () if isinstance(part, dict)]
            weighs = data.get("mass_kg") is not None or any(mass is not None for mass in masses)
            data["motion"] = "hinged" if data.get("hinge") is not None else "free" if weighs else "fixed"
        return data

    @model_validator(mode="after")
    def _fits_together(self) -> SceneBody:
        part_masses = [part.mass_kg for part in self.parts]
        if any(mass is not None for mass in part_masses) and None in part_masses:
            raise ValueError("either every part has a mass_kg or none has")
        if self.mass_kg is not None and None not in part_masses:
            raise ValueError("mass_kg of the body, or of every part, not both")
        if self.motion != "fixed" and self.mass_kg is None and None in part_masses:
            raise ValueError(f"a {self.motion} body needs a mass_kg")
        if (self.motion == "hinged") != (self.hinge is not None):
            raise ValueError("a hinged body has a hinge, and no other has")
        if self.ground and self.motion != "fixed":
            raise ValueError("only a fixed body can be ground")
        return self

    @property
    def part_masses_kg(self) -> tuple[float, ...] | None:
        """Mass of each part; None for a body without mass."""
        own = [part.mass_kg for part in self.parts]
        if None not in own:
            return tuple(mass for mass in own if mass is not None)
        if self.mass_kg is None:
            return None
        whole = sum(part.volume_m3 for part in self.parts)
        return tuple(self.mass_kg * part.volume_m3 / whole for part in self.parts)


class Mark(_Data):
    """A named place: where a seat's middle is and which way one faces there, what to hit, where to stand.

    Attributes:
        body: the object it moves with; its place is then `position_b_m` in that object's frame.
        position_w_m: the place in the world, for a mark that moves with nothing.
        heading_deg: which way one faces there, relative to the body's (or the world's) X.
        half_size_m: half sizes along and across that direction, for a mark that is an area (a seat).
    """

    body: Name | None = None
    position_b_m: Vec3 | None = None
    position_w_m: Vec3 | None = None
    heading_deg: FiniteFloat = 0.0
    half_size_m: tuple[Size, Size] | None = None

    @model_validator(mode="after")
    def _one_place(self) -> Mark:
        wanted = "position_w_m" if self.body is None else "position_b_m"
        given = [name for name in ("position_b_m", "position_w_m") if getattr(self, name) is not None]
        if given != [wanted]:
            raise ValueError(f"a mark {'without' if self.body is None else 'with'} a body has exactly a {wanted}")
        return self


class Scene(_Data):
    """A floor at z = 0 with objects and marks on it."""

    name: Name = "inline"
    description: Annotated[str, Field(max_length=500)] = ""
    bodies: Annotated[tuple[SceneBody, ...], Field(max_length=MAX_BODIES)] = ()
    marks: Annotated[dict[Name, Mark], Field(max_length=64)] = {}

    @model_validator(mode="after")
    def _names_fit(self) -> Scene:
        names = [body.name for body in self.bodies]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"two bodies share the name {', '.join(twice)}")
        for mark, place in self.marks.items():
            if place.body is not None and place.body not in names:
                raise ValueError(f"mark {mark!r} is on {place.body!r}, which is not a body: {', '.join(names)}")
        return self

    def body(self, name: str) -> SceneBody | None:
        """The body of that name, or None."""
        return next((body for body in self.bodies if body.name == name), None)
