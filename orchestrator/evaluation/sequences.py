"""`sequence`: five random tasks one after the other in the scene `room`, each with two retries."""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np

from orchestrator.evaluation.starts import LIMBS, Start
from shared.scenes.files import load_scene
from shared.scenes.placing import mark_place, sampled
from shared.scenes.schema import Scene

SEQUENCE = "sequence"
SCENE = "room"
LENGTH, RETRIES = 5, 2
KINDS = ("reach", "strike", "sit", "halt")
FREE_M = 1.2
"""Points to reach keep so far from the bag and from the sofa's middle."""
FLOOR_M = ((-1.5, 2.0), (-1.0, 1.5))


def sequence_of(seed: int) -> Start:
    """Five tasks drawn by a seed. Who sits gets up next; no kind comes twice in a row."""
    rng = np.random.default_rng(seed)
    heading = float(rng.uniform(-pi, pi))
    scene = sampled(load_scene(SCENE), seed)
    tasks: list[dict[str, Any]] = []
    while len(tasks) < LENGTH:
        last = str(tasks[-1]["type"]) if tasks else None
        kind = "get_up" if last == "sit" else str(rng.choice([kind for kind in KINDS if kind != last]))
        task: dict[str, Any] = {"type": kind, "retries": RETRIES}
        if kind == "reach":
            task["position_m"] = _free_point(scene, rng)
        elif kind == "strike":
            task["limb"] = LIMBS[int(rng.integers(len(LIMBS)))]
        tasks.append(task)
    return Start(tasks, scene, heading, None)


def _free_point(scene: Scene, rng: np.random.Generator) -> tuple[float, float]:
    """A point of the floor away from what stands there."""
    things = [mark_place(scene, name).position_w_m[:2] for name in ("bag_centre", "seat_centre")]
    while True:
        point = np.array([rng.uniform(*span) for span in FLOOR_M])
        if all(float(np.linalg.norm(point - thing)) >= FREE_M for thing in things):
            return float(point[0]), float(point[1])
