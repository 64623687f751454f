"""What a character is made of for physics: proportions, masses, servos. A registry by name.

The others are the human scaled: with lengths times s and mass times m, torques against gravity go with m s, and so do
the servos' stiffness and effort. Times go with the square root of s (Froude), so damping goes with m s^1.5 and inertia
with m s^2: a smaller body is as stiff and as well damped for its own, quicker motion.
"""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from shared.motion.characters import BUILDS, Build, build
from shared.motion.skeleton import CANONICAL, Skeleton, skeleton


class ServoSpec(BaseModel):
    """Position servo of the hinges of one kind of joint.

    Attributes:
        stiffness: N m / rad. damping: N m s / rad. effort_nm: the most torque it gives.
    """

    model_config = ConfigDict(frozen=True)
    stiffness: float = Field(gt=0)
    damping: float = Field(gt=0)
    effort_nm: float = Field(gt=0)


class Character(BaseModel):
    """Description of a character the humanoid is built from.

    Attributes:
        name: in the registry.
        skeleton_id: see shared.motion.skeleton.
        mass_kg: of the whole body.
        mass_fractions: share of each body; a sided name (`hip`) counts for left and right each.
        servos: by joint kind, the name without side and number.
        armature: rotor inertia added to each hinge, kg m^2.
        sole_friction: sliding friction of the body against the world.
    """

    model_config = ConfigDict(frozen=True)
    name: str
    skeleton_id: str
    mass_kg: float = Field(gt=0)
    mass_fractions: dict[str, float]
    servos: dict[str, ServoSpec]
    armature: float = Field(ge=0)
    sole_friction: float = Field(gt=0)

    @property
    def skeleton(self) -> Skeleton:
        """The skeleton by its id."""
        return skeleton(self.skeleton_id)

    def body_mass_kg(self, joint: str) -> float:
        """Mass of the body of one joint."""
        return self.mass_kg * self.mass_fractions[joint.removeprefix("left_").removeprefix("right_")]

    def servo(self, joint: str) -> ServoSpec:
        """Servo of one joint's hinges."""
        return self.servos[joint.removeprefix("left_").removeprefix("right_").rstrip("0123456789")]


# Segment masses of men after de Leva (1996), table 4; the trunk's thirds spread over pelvis, spine and collars.
_MASS_FRACTIONS = {
    "pelvis": 0.1117, "spine1": 0.0817, "spine2": 0.0816, "spine3": 0.1196, "collar": 0.02,
    "neck": 0.012, "head": 0.0574, "hip": 0.1416, "knee": 0.0433, "ankle": 0.0117, "foot": 0.0020,
    "shoulder": 0.0271, "elbow": 0.0162, "wrist": 0.0061,
}  # fmt: skip

# Stiffness after the slim PHC of CLoSD (REFERENCE 2), half its damping, efforts ours. With its ten to one and 400 N m
# the damping alone ate the whole effort at 5 rad/s: in half of all walking and 92 % of running ticks some joint could
# not follow, whatever the policy did (docs/experiments_tracker.md). What a joint feels is the servo's effort less its
# damping; the policy leads the reference by at most 0.4 rad, 320 N m at a hip.
_STRONG = ServoSpec(stiffness=800, damping=40, effort_nm=800)
_TRUNK = ServoSpec(stiffness=1000, damping=50, effort_nm=800)
_LIGHT = ServoSpec(stiffness=500, damping=25, effort_nm=400)

HUMAN = Character(
    name="human",
    skeleton_id=CANONICAL.id,
    mass_kg=BUILDS["human"].mass_kg,
    mass_fractions=_MASS_FRACTIONS,
    servos={
        "hip": _STRONG, "knee": _STRONG, "ankle": _STRONG, "spine": _TRUNK,
        "neck": _LIGHT, "foot": _LIGHT, "collar": _LIGHT, "shoulder": _LIGHT, "elbow": _LIGHT,
    },
    armature=0.02,
    sole_friction=1.0,
)  # fmt: skip


def _scaled(frame: Build) -> Character:
    """The human in another size and weight: see the module's docstring."""
    s, m = frame.skeleton.height_m / HUMAN.skeleton.height_m, frame.mass_kg / HUMAN.mass_kg
    servos = {
        joint: ServoSpec(
            stiffness=servo.stiffness * m * s, damping=servo.damping * m * s**1.5, effort_nm=servo.effort_nm * m * s
        )
        for joint, servo in HUMAN.servos.items()
    }
    changes = {"name": frame.name, "skeleton_id": frame.skeleton_id, "mass_kg": frame.mass_kg, "servos": servos}
    return HUMAN.model_copy(update={**changes, "armature": HUMAN.armature * m * s * s})


CHARACTERS = {name: HUMAN if name == HUMAN.name else _scaled(frame) for name, frame in BUILDS.items()}


def character(name: str) -> Character:
    """Character by name; raises InvalidInputError listing the known ones."""
    return CHARACTERS[build(name).name]
