"""The humanoid as a MuJoCo model, built by code from a skeleton and a `Character`; no SMPL file.

Every joint of the skeleton is a body whose frame coincides with the skeleton's joint frame (T-pose aligned), so body
positions and rotations of the simulation are joint positions and rotations of the motion. Hinges: see
`tracker_service.simulation.hinges`. The body collides with the world; of itself, forearms and hands collide with the
trunk, the thighs and each other, and the thighs with each other (3 % of a step's time).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import mujoco
import numpy as np
import numpy.typing as npt

from shared.motion.rotations import quat_from_matrix
from shared.motion.skeleton import CANONICAL, Skeleton
from shared.protocol.rates import PHYSICS_HZ
from tracker_service.simulation.character_spec import Character
from tracker_service.simulation.hinges import Hinges, human_hinges

Array = npt.NDArray[np.float64]

TRUNK = ("pelvis", "spine1", "spine2", "spine3", "neck", "head")
"""Bodies that touch the floor only when fallen or lying."""
FEET = ("left_ankle", "left_foot", "right_ankle", "right_foot")

# contype/conaffinity bits: the world collides with everything; arms and thighs also with what they may not enter.
WORLD_BIT, BODY_BIT, ARM_BIT, TRUNK_BIT, THIGH_BIT = 1, 2, 4, 8, 16
_SELF_BITS = {
    **dict.fromkeys(("elbow", "wrist"), (ARM_BIT, ARM_BIT | TRUNK_BIT | THIGH_BIT)),
    **dict.fromkeys(("pelvis", "spine1", "spine2", "spine3", "head"), (TRUNK_BIT, 0)),
    "hip": (THIGH_BIT, THIGH_BIT),
}
"""Own and sought bits of the kinds of bodies that take part in self-collision."""

_TRUE = mujoco.mjtLimited.mjLIMITED_TRUE


@dataclass(frozen=True)
class Humanoid:
    """A character's hinges, gains and names, apart from any scene. H hinges, J = 22 bodies.

    Attributes:
        character: its description.
        skeleton: its skeleton.
        hinges: its hinges.
        stiffness, damping: (H,) servo gains.
    """

    character: Character
    skeleton: Skeleton
    hinges: Hinges
    stiffness: Array
    damping: Array


@lru_cache(maxsize=8)
def _humanoid(name: str, character_json: str) -> Humanoid:
    description = Character.model_validate_json(character_json)
    skeleton = description.skeleton
    hinges = Hinges(skeleton, human_hinges(skeleton))
    servos = [description.servo(skeleton.names[j]) for j in hinges.joint_of]
    stiffness = np.array([s.stiffness for s in servos])
    damping = np.array([s.damping for s in servos])
    return Humanoid(description, skeleton, hinges, stiffness, damping)


def humanoid(character: Character) -> Humanoid:
    """The humanoid of a character (built once for each description)."""
    return _humanoid(character.name, character.model_dump_json())


def _geoms(skeleton: Skeleton, joint: str) -> list[dict[str, object]]:
    """Shapes of one body in its frame, sizes for the canonical skeleton scaled by stature, radii also by girth."""
    s = skeleton.height_m / CANONICAL.height_m
    g = s * skeleton.girth
    capsule, box, sphere = mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_SPHERE
    kind = joint.removeprefix("left_").removeprefix("right_")
    side = -1.0 if joint.startswith("right_") else 1.0

    def across(half: float, x: float, z: float, radius: float) -> dict[str, object]:
        ends = [x * s, -half * s, z * s, x * s, half * s, z * s]
        return {"type": capsule, "fromto": ends, "size": [radius * g, 0, 0]}

    def along(child: str, radius: float, start: float = 0.0) -> dict[str, object]:
        end = skeleton.offsets_m[skeleton.index(child)]
        begin = end / np.linalg.norm(end) * start * s
        return {"type": capsule, "fromto": [*begin, *end], "size": [radius * g, 0, 0]}

    prefix = "left_" if side > 0 else "right_"
    if kind == "pelvis":
        return [across(0.07, -0.01, -0.02, 0.095)]
    if kind == "spine1":
        return [across(0.06, 0.01, 0.06, 0.09)]
    if kind == "spine2":
        return [across(0.06, 0.0, 0.03, 0.095)]
    if kind == "spine3":
        return [across(0.08, -0.01, 0.07, 0.1)]
    if kind == "neck":
        return [along("head", 0.045)]
    if kind == "head":
        return [{"type": sphere, "pos": [0.01 * s, 0, 0.065 * s], "size": [0.095 * s, 0, 0]}]
    if kind == "collar":
        return [along(prefix + "shoulder", 0.045, 0.03)]
    if kind == "hip":
        return [along(prefix + "knee", 0.065, 0.05)]
    if kind == "knee":
        return [along(prefix + "ankle", 0.048, 0.02)]
    if kind == "shoulder":
        return [along(prefix + "elbow", 0.043, 0.02)]
    if kind == "elbow":
        return [along(prefix + "wrist", 0.034, 0.02)]
    if kind == "wrist":
        # A hand that bears weight is bent back at the wrist, for which there is no hinge: going on along the forearm it
        # would be 12 cm deep in the floor whenever somebody gets up from it. So the hand is the heel of the hand.
        return [{"type": sphere, "pos": [0, side * 0.01 * s, 0], "size": [0.036 * s, 0, 0]}]
    toe = skeleton.offsets_m[skeleton.index(prefix + "foot")]
    if kind == "ankle":
        sole = -foot_height_m(skeleton)
        heel, front, half_z = -0.055 * s, float(toe[0]), 0.024 * s
        centre = [(heel + front) / 2, 0, sole + half_z]
        return [{"type": box, "pos": centre, "size": [(front - heel) / 2, 0.043 * s, half_z]}]
    half_z = 0.012 * s
    centre = [0.035 * s, 0, -(foot_height_m(skeleton) + float(toe[2])) + half_z]
    return [{"type": box, "pos": centre, "size": [0.035 * s, 0.043 * s, half_z]}]


def foot_height_m(skeleton: Skeleton) -> float:
    """Height of the ankle over a flat sole in the rest pose."""
    return float(skeleton.rest_positions_m[skeleton.index("left_ankle"), 2])


def humanoid_spec(human: Humanoid) -> mujoco.MjSpec:
    """The humanoid over a floor as an MjSpec, to which a scene's objects can be added before it is compiled.

    Joint order: the free root, then the hinges in the order of `human.hinges`; one position actuator a hinge. The
    servo's damping sits in the joint: MuJoCo integrates it implicitly even while the servo's force is at its limit (an
    actuator's own kv is explicit then, and light limbs explode).
    """
    skeleton, character = human.skeleton, human.character
    spec = mujoco.MjSpec()
    spec.modelname = character.name
    spec.compiler.degree = False
    spec.option.timestep = 1.0 / PHYSICS_HZ
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_SPARSE
    spec.option.iterations = 12
    spec.option.ls_iterations = 12
    spec.option.disableflags = int(mujoco.mjtDisableBit.mjDSBL_AUTORESET) | int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP)
    spec.worldbody.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0, 0, 0.05],
        friction=[character.sole_friction, 0.005, 0.0001],
        contype=WORLD_BIT,
        conaffinity=BODY_BIT,
        rgba=[0.55, 0.58, 0.62, 1],
    )
    bodies: list[mujoco.MjsBody] = []
    for joint, name in enumerate(skeleton.names):
        if joint == 0:
            body = spec.worldbody.add_body(name=name, pos=[0, 0, skeleton.root_height_m])
            body.add_freejoint(name="root")
        else:
            hinge_spec = human.hinges.specs[joint - 1]
            body = bodies[skeleton.parents[joint]].add_body(
                name=name, pos=skeleton.offsets_m[joint], quat=quat_from_matrix(hinge_spec.rest)
            )
            for slot in range(hinge_spec.count):
                body.add_joint(
                    name=f"{name}_{slot}",
                    type=mujoco.mjtJoint.mjJNT_HINGE,
                    axis=hinge_spec.rest.T @ hinge_spec.axes[:, slot],
                    range=hinge_spec.limits_rad[slot],
                    limited=_TRUE,
                    armature=character.armature,
                    damping=[character.servo(name).damping, 0, 0],
                )
        bodies.append(body)
        shapes = _geoms(skeleton, name)
        own, sought = _SELF_BITS.get(name.removeprefix("left_").removeprefix("right_"), (0, 0))
        for k, shape in enumerate(shapes):
            body.add_geom(
                name=f"{name}_geom{k}",
                mass=character.body_mass_kg(name) / len(shapes),
                friction=[character.sole_friction, 0.005, 0.0001],
                contype=BODY_BIT | own,
                conaffinity=WORLD_BIT | sought,
                rgba=[0.80, 0.62, 0.48, 1] if "right" not in name else [0.55, 0.62, 0.80, 1],
                **shape,
            )
    for h, name in enumerate(human.hinges.names):
        servo = character.servo(skeleton.names[human.hinges.joint_of[h]])
        actuator = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        actuator.set_to_position(kp=servo.stiffness)
        actuator.forcelimited = _TRUE
        actuator.forcerange = [-servo.effort_nm, servo.effort_nm]
    return spec


def body_ids(model: mujoco.MjModel, skeleton: Skeleton) -> npt.NDArray[np.int64]:
    """(J,) MuJoCo's body id of each joint; MuJoCo orders bodies depth-first."""
    return np.array([model.body(name).id for name in skeleton.names])


def humanoid_model(human: Humanoid) -> mujoco.MjModel:
    """The humanoid alone on the floor, compiled (training uses this one)."""
    return humanoid_spec(human).compile()
