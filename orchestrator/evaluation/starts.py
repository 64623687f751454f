"""How an episode of `eval tasks` begins: where the object is, which way the body faces, which limb it is."""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, cos, floor, pi, sin
from typing import Any

import numpy as np

from shared.errors import InvalidInputError
from shared.motion.rotations import wrap_angle
from shared.scenes.files import load_scene
from shared.scenes.placing import sampled
from shared.scenes.schema import RandomRanges, Scene
from shared.tasks.factory import KINDS

STRIKE_M, SIT_M, FRONT_RAD = (1.0, 1.5), (1.0, 1.2), pi / 3
VARY = (0.8, 1.2)
SEAT_TOP_M = (0.2, 0.6)
"""Sizes, distances and heights of seats where objects vary."""
LIMBS = ("left_hand", "right_hand", "left_foot", "right_foot")
TASKS: dict[str, list[dict[str, Any]]] = {
    "reach": [{"type": "reach"}],
    "halt": [{"type": "halt"}],
    "text": [{"type": "text", "text": "a person is walking forward."}],
    "velocity": [{"type": "velocity", "relative_mps": (1.0, 0.0)}],
    "strike": [{"type": "strike"}],
    "sit": [{"type": "sit"}],
    "get_up": [{"type": "sit", "retries": 2}, {"type": "get_up"}],
    "get_up_floor": [
        {"type": "text", "text": "a person lies down on the floor.", "duration_s": 4},
        {"type": "get_up", "from": "floor"},
    ],
}
"""What an episode of each holds; the last task is the one that counts. Who is to get up may try thrice to sit down
first: whether the first try succeeds is what `sit` measures."""


@dataclass(frozen=True)
class Start:
    """Attributes:
    heading_rad: which way the body at the origin faces. bearing_rad: of the object from there, where there is one.
    """

    tasks: list[dict[str, Any]]
    scene: str | Scene
    heading_rad: float
    bearing_rad: float | None


def start_of(task: str, seed: int, varied: bool = False) -> Start:
    """The start of an episode, drawn by its seed: every direction of object and body is as likely.

    The bag stands 1 to 1.5 m away; the seat's middle 1 to 1.2 m, the body within 60 deg of its front.

    Args:
        varied: sizes and distances of bag and sofa 20 % smaller to larger, seats of 0.2 to 0.6 m. All else is as
            without, for the same seed.

    Raises:
        InvalidInputError: there is no such task.
    """
    rng = np.random.default_rng(seed)
    heading = float(rng.uniform(-pi, pi))
    if task not in TASKS:
        if task not in KINDS:
            allowed = ", ".join(dict.fromkeys([*TASKS, *KINDS]))
            raise InvalidInputError(f"unknown task {task!r}", field="tasks", allowed=allowed)
        return Start([{"type": task}], "flat", heading, None)
    tasks = [dict(each) for each in TASKS[task]]
    sizes = np.random.default_rng((seed, 1))
    farther = float(sizes.uniform(*VARY)) if varied else 1.0
    if task == "strike":
        tasks[-1]["limb"] = LIMBS[int(rng.integers(len(LIMBS)))]
        angle, distance = float(rng.uniform(-pi, pi)), farther * float(rng.uniform(*STRIKE_M))
        bag = _resized("bag", VARY, seed) if varied else load_scene("bag")
        scene = _moved(bag, (distance * cos(angle), distance * sin(angle)), float(rng.uniform(-180, 180)))
        return Start(tasks, scene, heading, float(wrap_angle(angle - heading)))
    if task in ("sit", "get_up"):
        faces, aside = float(rng.uniform(-pi, pi)), float(rng.uniform(-FRONT_RAD, FRONT_RAD))
        distance = farther * float(rng.uniform(*SIT_M))
        middle = -distance * np.array([cos(faces + aside), sin(faces + aside)])
        sofa = load_scene("sofa")
        ahead, left, top = sofa.marks["seat_centre"].position_b_m or (0.0, 0.0, 0.0)
        if varied:
            sofa = _resized("sofa", (SEAT_TOP_M[0] / top, SEAT_TOP_M[1] / top), seed)
            ahead, left, _ = sofa.marks["seat_centre"].position_b_m or (0.0, 0.0, 0.0)
        x = float(middle[0]) - ahead * cos(faces) + left * sin(faces)
        y = float(middle[1]) - ahead * sin(faces) - left * cos(faces)
        scene = _moved(sofa, (x, y), float(np.rad2deg(faces)))
        return Start(tasks, scene, heading, float(wrap_angle(atan2(middle[1], middle[0]) - heading)))
    return Start(tasks, "flat", heading, None)


def octant(bearing_rad: float) -> int:
    """0 straight ahead, anticlockwise to 7: each 45 deg wide, and 0 from -22.5 to 22.5 deg."""
    return floor((float(wrap_angle(bearing_rad)) + pi / 8) / (pi / 4)) % 8


def _resized(name: str, heights: tuple[float, float], seed: int) -> Scene:
    """A scene of the package with its one body of another size and, by itself, height, as a seed draws them."""
    scene = load_scene(name)
    (body,) = scene.bodies
    ranges = RandomRanges(size=VARY, height=heights)
    return sampled(scene.model_copy(update={"bodies": (body.model_copy(update={"random": ranges}),)}), seed)


def _moved(scene: Scene, xy_m: tuple[float, float], heading_deg: float) -> Scene:
    """A scene with its one body somewhere else."""
    (body,) = scene.bodies
    moved = body.model_copy(update={"position_w_m": (*xy_m, 0.0), "heading_deg": heading_deg, "random": None})
    return scene.model_copy(update={"bodies": (moved,)})
