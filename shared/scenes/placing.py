"""A scene for a seed, and where its marks are while its objects move. Pure functions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.motion.heading import heading_of
from shared.motion.rotations import matrix_from_quat
from shared.scenes.schema import Mark, Part, RandomRanges, Scene, SceneBody, Vec3

Array = npt.NDArray[np.floating]


@dataclass(frozen=True)
class Place:
    """A mark in the world now.

    Attributes:
        position_w_m: (3,). heading_rad: which way one faces there, about Z.
        half_size_m: half sizes along and across that direction, or None.
    """

    position_w_m: Array
    heading_rad: float
    half_size_m: tuple[float, float] | None


def sampled(scene: Scene, seed: int) -> Scene:
    """The scene with every random range drawn: the same for the same seed everywhere; one without ranges as it is."""
    if not any(body.random for body in scene.bodies):
        return scene
    rng = np.random.default_rng(seed)
    bodies, scales = [], {}
    for body in scene.bodies:
        drawn, scales[body.name] = _drawn(body, rng)
        bodies.append(drawn)
    marks = {name: _scaled_mark(mark, scales.get(mark.body or "", (1.0, 1.0))) for name, mark in scene.marks.items()}
    return scene.model_copy(update={"bodies": tuple(bodies), "marks": marks})


def pose_of(body: SceneBody) -> Array:
    """(7,) position and quaternion of a body as its file has it."""
    half = np.deg2rad(body.heading_deg) / 2
    return np.array([*body.position_w_m, np.cos(half), 0.0, 0.0, np.sin(half)])


def top_m(body: SceneBody) -> float:
    """How high the highest of its parts reaches above its frame, as it stands; parts that are turned count as not."""

    def half(part: Part) -> float:
        if part.shape == "box":
            return part.size_m[2]
        round_end = 0.0 if part.shape == "cylinder" else part.size_m[0]
        return round_end if part.shape == "sphere" else part.size_m[1] + round_end

    return max(part.position_b_m[2] + half(part) for part in body.parts)


def mark_place(scene: Scene, name: str, pose_w: Array | None = None) -> Place:
    """Where a mark is.

    Args:
        pose_w: (7,) pose now of the body it is on; None: as the scene has it.
    """
    mark = scene.marks[name]
    heading = np.deg2rad(mark.heading_deg)
    body = None if mark.body is None else scene.body(mark.body)
    if body is None:
        return Place(np.array(mark.position_w_m, dtype=np.float64), float(heading), mark.half_size_m)
    pose = np.asarray(pose_of(body) if pose_w is None else pose_w, dtype=np.float64)
    turn = matrix_from_quat(pose[3:] / np.linalg.norm(pose[3:]))
    faces = turn @ np.array([np.cos(heading), np.sin(heading), 0.0])
    position = pose[:3] + turn @ np.array(mark.position_b_m, dtype=np.float64)
    return Place(position, float(heading_of(faces)), mark.half_size_m)


def _drawn(body: SceneBody, rng: np.random.Generator) -> tuple[SceneBody, tuple[float, float]]:
    """A body without ranges, and its factors of size and height."""
    ranges = body.random or RandomRanges()

    def within(span: tuple[float, float] | None, usual: float) -> float:
        share = rng.random()  # always drawn, so that one range more leaves the others' values as they were
        return usual if span is None else float(span[0] + share * (span[1] - span[0]))

    spans = ranges.position_m or (None, None)
    x, y = (within(span, 0.0) for span in spans)
    turn = within(ranges.heading_deg, 0.0)
    size = within(ranges.size, 1.0)
    height = within(ranges.height, size)
    mass, friction = within(ranges.mass, 1.0), within(ranges.friction, 1.0)
    if body.random is None:
        return body, (1.0, 1.0)
    px, py, pz = body.position_w_m
    scale = (size, height)
    changes = {
        "position_w_m": (px + x, py + y, pz * height),
        "heading_deg": body.heading_deg + turn,
        "parts": tuple(_scaled_part(part, scale, mass, friction) for part in body.parts),
        "mass_kg": None if body.mass_kg is None else body.mass_kg * mass,
        "friction": body.friction * friction,
        "hinge": None
        if body.hinge is None
        else body.hinge.model_copy(update={"anchor_b_m": _scaled(body.hinge.anchor_b_m, scale)}),
        "random": None,
    }
    return body.model_copy(update=changes), scale


def _scaled(point: Vec3, scale: tuple[float, float]) -> Vec3:
    return point[0] * scale[0], point[1] * scale[0], point[2] * scale[1]


def _scaled_part(part: Part, scale: tuple[float, float], mass: float, friction: float) -> Part:
    """A part scaled along its own axes: heights are what lies along its Z."""
    size, height = scale
    sizes: tuple[float, ...]
    if part.shape == "box":
        sizes = (part.size_m[0] * size, part.size_m[1] * size, part.size_m[2] * height)
    elif part.shape == "sphere":
        sizes = (part.size_m[0] * size,)
    else:
        sizes = (part.size_m[0] * size, part.size_m[1] * height)
    changes = {
        "size_m": sizes,
        "position_b_m": _scaled(part.position_b_m, scale),
        "mass_kg": None if part.mass_kg is None else part.mass_kg * mass,
        "friction": None if part.friction is None else part.friction * friction,
    }
    return part.model_copy(update=changes)


def _scaled_mark(mark: Mark, scale: tuple[float, float]) -> Mark:
    changes: dict[str, object] = {}
    if mark.position_b_m is not None:
        changes["position_b_m"] = _scaled(mark.position_b_m, scale)
    if mark.half_size_m is not None:
        changes["half_size_m"] = tuple(v * scale[0] for v in mark.half_size_m)
    return mark.model_copy(update=changes)
