"""The bag in training: what a blow and the push after it meet.

It is the bag of the scene `bag` on a joint at the middle of its base instead of a floor under its edge. What the edge
gives, the moment that it takes to lean it at all, is dry friction here: it leans and goes down as the real one does,
only that it does not rock back. So a bag costs two degrees of freedom and no contacts with the floor.
"""

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt

from shared.scenes.files import load_scene
from shared.tasks.object_rules import GRAVITY_MPS2
from tracker_service.simulation.humanoid import BODY_BIT, WORLD_BIT

Floats = npt.NDArray[np.floating]

BAG_DOFS = 2
LOWEST_RAD = 1.45
"""Lying: so far it leans at most."""
NO_BAG = (0.0, 0.0, -5.0, 0.0, 0.0)
"""x, y and height of where its base stands, how far it leans about X and then about its own Y; out of the way."""
Bag = tuple[float, float, float, float, float]
CLEAR_M = 0.32
"""Joints farther than this from the bag's axis are clear of it: its radius, a body's and some room."""


def add_bag(spec: mujoco.MjSpec) -> None:
    """Add a mocap body `bag_base` that carries the bag; to be added after everything else that moves."""
    (body,) = load_scene("bag").bodies
    base, weight = body.parts[0], sum(part.mass_kg or 0.0 for part in body.parts) * GRAVITY_MPS2
    stand = spec.worldbody.add_body(name="bag_base", mocap=True, pos=list(NO_BAG[:3]))
    bag = stand.add_body(name="bag")
    for axis, name in enumerate(("bag_x", "bag_y")):
        bag.add_joint(
            name=name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=np.eye(3)[axis], range=[-LOWEST_RAD, LOWEST_RAD],
            limited=1, frictionloss=weight * base.size_m[0],
        )  # fmt: skip
    for part in body.parts:
        bag.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[*part.size_m, 0.0], pos=part.position_b_m, mass=part.mass_kg,
            friction=[body.friction, 0.005, 0.0001], contype=WORLD_BIT, conaffinity=BODY_BIT,
        )  # fmt: skip


def lean_of(up_w: Floats) -> npt.NDArray[np.float64]:
    """(..., 2) how far a bag leans about X and then about its own Y, whose axis points along unit vectors (..., 3)."""
    x, y, z = np.moveaxis(np.asarray(up_w, dtype=np.float64), -1, 0)
    lean = np.stack([np.arctan2(-y, z), np.arcsin(np.clip(x, -1.0, 1.0))], axis=-1)
    return np.clip(lean, -LOWEST_RAD, LOWEST_RAD)


def last_clear(pos_w_m: Floats, bag: Floats) -> int:
    """The last tick of a clip (T, J, 3) before the body comes to its bag, 0 where it begins there."""
    away = np.linalg.norm(pos_w_m[..., :2] - bag[:2], axis=-1).min(axis=1)
    near = np.flatnonzero(away < CLEAR_M)
    return max(int(near[0]) - 1, 0) if len(near) else len(pos_w_m) - 1


def latest_starts(
    pos_w_m: Floats, start: npt.NDArray[np.int64], length: npt.NDArray[np.int64], bags: Floats
) -> npt.NDArray[np.int64]:
    """(C,) the last tick at which an episode of each clip may begin, `last_clear`; its length where no bag is."""
    out = length.copy()
    for clip in np.flatnonzero(bags[:, 2] >= 0):
        out[clip] = last_clear(pos_w_m[start[clip] :][: length[clip]], bags[clip])
    return out
