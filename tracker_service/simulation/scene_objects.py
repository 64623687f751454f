"""A scene's bodies as MuJoCo geoms and joints, added to a spec.

Upright cylinders are not left to MuJoCo's own contact of cylinder and plane: when the axis is parallel to the plane's
normal but for rounding, it divides by what rounding left and throws the body up (seen in 4.0.0: a bag of 63 kg at rest
left the floor at 2 m/s). Their ends stand on rims of small spheres, their sides lie on a capsule, both of which know
only the floor; the cylinder itself meets everything but the floor.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from shared.motion.rotations import matrix_from_quat
from shared.scenes.placing import pose_of
from shared.scenes.schema import Part, SceneBody
from tracker_service.simulation.humanoid import BODY_BIT, WORLD_BIT

OBJECT_PREFIX = "object_"
OBJECT_BIT, FLOOR_BIT = 32, 64
"""Contact bits beside those of the humanoid: objects among themselves, and what meets the floor alone."""
SURFACE_GROUP, GROUND_GROUP = 3, 4
"""Geom groups that rays for heights see: seats and the like, and what counts as floor."""
RIM_SPHERES = 16
RIM_RADIUS_M = 0.005
_SHAPES = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
}
_TRUE = mujoco.mjtLimited.mjLIMITED_TRUE


def add_object(spec: mujoco.MjSpec, item: SceneBody, seat: bool = False) -> None:
    """Add a body with its joint and its geoms; it collides with the humanoid, the floor and other objects.

    Args:
        seat: rays for heights see it although it is not fixed.
    """
    pose, name = pose_of(item), OBJECT_PREFIX + item.name
    # A fixed body is MuJoCo's mocap body: it has a pose in each character's own data, so that SetObject can move it.
    body = spec.worldbody.add_body(name=name, pos=pose[:3], quat=pose[3:], mocap=item.motion == "fixed")
    if item.motion == "free":
        body.add_freejoint(name=name)
    elif item.hinge is not None:
        hinge = item.hinge
        limits = {} if hinge.range_deg is None else {"limited": _TRUE, "range": np.deg2rad(hinge.range_deg)}
        body.add_joint(
            name=name, type=mujoco.mjtJoint.mjJNT_HINGE, pos=list(hinge.anchor_b_m), axis=list(hinge.axis_b),
            damping=[hinge.damping, 0, 0], stiffness=[hinge.stiffness, 0, 0], **limits,
        )  # fmt: skip
    masses = item.part_masses_kg
    rolling = item.rolling_friction_m
    for number, part in enumerate(item.parts):
        surface = {
            "priority": 1,  # an object's own friction counts, not the larger of it and the floor's
            "friction": [item.friction if part.friction is None else part.friction, 0.005, rolling or 0.0001],
            "condim": 3 if rolling is None else 6,
        }
        mass = {} if masses is None else {"mass": masses[number]}
        group = SURFACE_GROUP if seat else 0
        contype = conaffinity = WORLD_BIT | BODY_BIT | OBJECT_BIT
        if item.motion == "fixed":
            group = GROUND_GROUP if item.ground else SURFACE_GROUP
            contype, conaffinity = WORLD_BIT | OBJECT_BIT, 0  # meets what moves, not the floor nor its like
        elif part.shape == "cylinder":
            contype, conaffinity = WORLD_BIT | OBJECT_BIT, OBJECT_BIT
            _add_rims(body, part, surface)
        body.add_geom(
            name=f"{name}_{number}", type=_SHAPES[part.shape], size=[*part.size_m, 0.0, 0.0][:3],
            pos=list(part.position_b_m), quat=list(part.quat_b), contype=contype, conaffinity=conaffinity,
            group=group, **surface, **mass,
        )  # fmt: skip


def _add_rims(body: mujoco.MjsBody, part: Part, surface: dict[str, Any]) -> None:
    """What a cylinder stands and lies on: see the module's docstring."""
    radius, half = part.size_m
    turn, centre = matrix_from_quat(np.array(part.quat_b)), np.array(part.position_b_m)
    floor_only = {"contype": 0, "conaffinity": FLOOR_BIT, "mass": 0.0, **surface}
    ball = min(RIM_RADIUS_M, radius / 4, half / 4)
    for side in (-1.0, 1.0):
        for angle in np.arange(RIM_SPHERES) * (2 * np.pi / RIM_SPHERES):
            rim = np.array([np.cos(angle) * (radius - ball), np.sin(angle) * (radius - ball), side * (half - ball)])
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[ball, 0, 0], pos=centre + turn @ rim, **floor_only
            )  # fmt: skip
    if half > radius:
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=[radius, half - radius, 0], pos=centre,
            quat=list(part.quat_b), **floor_only,
        )  # fmt: skip
