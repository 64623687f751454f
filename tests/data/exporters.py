"""The names that exporters give to the joints of the walk of `tests.data.walks`, and the family each is told to be."""

from __future__ import annotations

from tests.data.walks import Spelling

LIMBS = ("Shoulder", "Arm", "ForeArm", "Hand", "UpLeg", "Leg", "Foot", "ToeBase")


def renamed(middle: dict[str, str], limb: str, parts: tuple[str, ...], sides: tuple[str, str]) -> Spelling:
    """Names from a pattern with {s} for the side and {p} for the part, the parts in the order of LIMBS."""
    names = dict(middle)
    for word, side in zip(("Left", "Right"), sides, strict=True):
        names |= {f"{word}{old}": limb.format(s=side, p=new) for old, new in zip(LIMBS, parts, strict=True)}
    return Spelling(names=names)


ABBREVIATED = ("Clavicle", "UpperArm", "Forearm", "Hand", "Thigh", "Calf", "Foot", "Toe0")
VRM = ("Shoulder", "UpperArm", "LowerArm", "Hand", "UpperLeg", "LowerLeg", "Foot", "ToeBase")
JOINT_WORDS = ("Collar", "Shoulder", "Elbow", "Wrist", "Hip", "Knee", "Ankle", "Foot")


def middle(pattern: str) -> dict[str, str]:
    return {name: pattern.format(p=name) for name in ("Hips", "Spine", "Chest", "Neck", "Head")}


EXPORTERS: dict[str, tuple[Spelling, str]] = {
    "biped": (renamed(middle("Bip001 {p}") | {"Hips": "Bip001"}, "Bip001 {s} {p}", ABBREVIATED, ("L", "R")), "3ds Max"),
    "biped 01": (renamed(middle("Bip01_{p}"), "Bip01_{s}_{p}", ABBREVIATED, ("L", "R")), "3ds Max"),
    "biped without blanks": (renamed(middle("Bip001{p}"), "Bip001{s}{p}", ABBREVIATED, ("L", "R")), "3ds Max"),
    "vroid": (renamed(middle("J_Bip_C_{p}"), "J_Bip_{s}_{p}", VRM, ("L", "R")), "VRoid"),
    "daz 3": (
        renamed(
            {"Hips": "hip", "Spine": "abdomenLower", "Chest": "chestLower", "Neck": "neckLower", "Head": "head"},
            "{s}{p}", ("Collar", "ShldrBend", "ForearmBend", "Hand", "ThighBend", "Shin", "Foot", "Toe"), ("l", "r"),
        ),
        "Daz",
    ),
    "daz 9": (
        renamed(middle("{p}"), "{s}_{p}",
                ("shoulder", "upperarm", "forearm", "hand", "thigh", "shin", "foot", "toes"), ("l", "r")),
        "Daz",
    ),
    "poser": (
        renamed({"Hips": "hip"}, "{s}{p}",
                ("Collar", "Shldr", "ForeArm", "Hand", "Thigh", "Shin", "Foot", "Toe"), ("l", "r")),
        "Daz",
    ),
    "mixamo": (Spelling(names=lambda n: f"mixamorig:{n}"), "Mixamo"),
    "mixamo 1": (Spelling(names=lambda n: f"mixamorig1:{n}"), "Mixamo"),
    "mixamo 12 underscore": (Spelling(names=lambda n: f"mixamorig12_{n}"), "Mixamo"),
    "mixamo glued": (Spelling(names=lambda n: f"mixamorig{n}"), "Mixamo"),
    "rokoko": (
        renamed({}, "{s}{p}", ("Shoulder", "Arm", "ForeArm", "Hand", "Thigh", "Shin", "Foot", "Toe"),
                ("Left", "Right")),
        "Rokoko",
    ),
    "unreal": (
        renamed({"Hips": "pelvis", "Spine": "spine_01", "Chest": "spine_03", "Neck": "neck_01", "Head": "head"},
                "{p}_{s}", ("clavicle", "upperarm", "lowerarm", "hand", "thigh", "calf", "foot", "ball"), ("l", "r")),
        "Unreal",
    ),
    "smpl-h": (renamed(middle("{p}") | {"Hips": "Pelvis"}, "{s}_{p}", JOINT_WORDS, ("L", "R")), "SMPL"),
    "smpl addon": (renamed(middle("m_avg_{p}"), "m_avg_{s}_{p}", JOINT_WORDS, ("L", "R")), "SMPL"),
    "smpl-x": (
        renamed(middle("{p}"), "{s}_{p}", tuple(w.lower() for w in JOINT_WORDS), ("left", "right")),
        "SMPL",
    ),
    "cmu names in a bvh": (
        renamed({"Hips": "root", "Chest": "thorax", "Neck": "lowerneck", "Head": "head"}, "{s}{p}",
                ("clavicle", "humerus", "radius", "wrist", "femur", "tibia", "foot", "toes"), ("l", "r")),
        "Acclaim",
    ),
    "human ik with a character": (Spelling(names=lambda n: f"Character1_{n}"), "HumanIK"),
    "xsens": (
        renamed({"Hips": "Pelvis", "Spine": "L3", "Chest": "T8"}, "{s}{p}",
                ("Shoulder", "UpperArm", "ForeArm", "Hand", "UpperLeg", "LowerLeg", "Foot", "Toe"), ("Left", "Right")),
        "Xsens",
    ),
    "perception neuron": (Spelling(names=lambda n: f"Robot_{n}"), "HumanIK"),
    "optitrack": (
        renamed({"Hips": "Hip", "Spine": "Ab"}, "{s}{p}",
                ("Shoulder", "UArm", "FArm", "Hand", "Thigh", "Shin", "Foot", "Toe"), ("L", "R")),
        "OptiTrack",
    ),
    "auto-rig pro": (
        renamed({"Hips": "root.x", "Neck": "neck.x", "Head": "head.x"}, "{p}.{s}",
                ("shoulder", "arm_stretch", "forearm_stretch", "hand", "thigh_stretch", "leg_stretch", "foot",
                 "toes_01"), ("l", "r")),
        "other",
    ),
    "mocopi": (
        renamed({"Hips": "root", "Spine": "torso_1", "Chest": "torso_7", "Neck": "neck_1", "Head": "head"}, "{s}_{p}",
                ("shoulder", "up_arm", "low_arm", "hand", "up_leg", "low_leg", "foot", "toes"), ("l", "r")),
        "other",
    ),
    "second life": (
        renamed(middle("m{p}") | {"Hips": "mPelvis"}, "m{p}{s}",
                ("Collar", "Shoulder", "Elbow", "Wrist", "Hip", "Knee", "Ankle", "Foot"), ("Left", "Right")),
        "other",
    ),
    "source": (
        renamed(middle("ValveBiped.Bip01_{p}"), "ValveBiped.Bip01_{s}_{p}", ABBREVIATED, ("L", "R")),
        "Source",
    ),
    "makehuman": (
        renamed({"Hips": "root", "Neck": "neck01"}, "{p}.{s}",
                ("clavicle", "upperarm01", "lowerarm01", "wrist", "upperleg01", "lowerleg01", "foot", "toe1-1"),
                ("L", "R")),
        "other",
    ),
    "b prefix": (
        renamed(middle("b_{p}") | {"Hips": "b_root"}, "b_{s}_{p}",
                ("shoulder", "arm", "forearm", "wrist", "upleg", "leg", "foot", "ball"), ("l", "r")),
        "other",
    ),
    "kinect": (
        renamed({"Hips": "SpineBase"}, "{p}{s}",
                ("Clavicle", "Shoulder", "Elbow", "Wrist", "Hip", "Knee", "Ankle", "Foot"), ("Left", "Right")),
        "other",
    ),
    "upper and lower": (
        renamed({}, "{s}{p}", ("Collar", "ArmUpper", "ArmLower", "Hand", "LegUpper", "LegLower", "Foot", "Toe"),
                ("Left", "Right")),
        "other",
    ),
    "rigify": (
        renamed({}, "DEF-{p}.{s}", ("shoulder", "upper_arm", "forearm", "hand", "thigh", "shin", "foot", "toe"),
                ("L", "R")),
        "Rigify",
    ),
    "jnt": (Spelling(names=lambda n: f"{n}_JNT"), "HumanIK"),
    "a studio's own prefix": (Spelling(names=lambda n: f"Dancer07_{n}"), "HumanIK"),
    "hip knee ankle": (
        renamed({}, "{s}{p}", ("Collar", "Shoulder", "Elbow", "Wrist", "Hip", "Knee", "Ankle", "Toe"),
                ("Left", "Right")),
        "hip-knee-ankle",
    ),
}  # fmt: skip
