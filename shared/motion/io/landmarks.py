"""Anatomical landmarks of any reasonable skeleton, found by joint names and by the shape of the tree."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from shared.errors import InvalidInputError
from shared.motion.io.names import normalise, shared_words, words_of

Array = npt.NDArray[np.float64]

# Names are compared in lower case without separators, prefixes, side words or digits at the end.
# For each landmark the aliases come in order of preference.
ALIASES: dict[str, tuple[str, ...]] = {
    "hip": ("upleg", "thigh", "upperleg", "hip", "uleg", "femur", "femurstart", "legupper", "hipjoint"),
    "knee": ("leg", "calf", "knee", "shin", "lowerleg", "lowleg", "shank", "lleg", "leglower", "tibia"),
    "ankle": ("foot", "ankle"),
    "toe": ("toebase", "toe", "ball", "toes", "forefoot", "foottoe", "footend"),
    "collar": ("shoulder", "clavicle", "collar", "clav", "scapula"),
    "shoulder": ("arm", "upperarm", "shoulder", "shldr", "uparm", "uarm", "armupper", "humerus"),
    "elbow": ("forearm", "elbow", "lowerarm", "lowarm", "farm", "larm", "armlower", "radius"),
    "wrist": ("wrist", "hand"),
    "head": ("head",),
    "neck": ("neck", "lowerneck", "necklower", "necktwist"),
}

# Acclaim bones name segments; their joint (see asfamc) is the segment's far end.
ACCLAIM: dict[str, str] = {
    "left_hip": "lhipjoint",
    "right_hip": "rhipjoint",
    "left_knee": "lfemur",
    "right_knee": "rfemur",
    "left_ankle": "ltibia",
    "right_ankle": "rtibia",
    "left_toe": "lfoot",
    "right_toe": "rfoot",
    "left_shoulder": "lclavicle",
    "right_shoulder": "rclavicle",
    "left_elbow": "lhumerus",
    "right_elbow": "rhumerus",
    "left_wrist": "lradius",
    "right_wrist": "rradius",
    "neck": "lowerneck",
    "head": "upperneck",
}
# Which joint's rotation is the segment's own.
ACCLAIM_SEGMENTS: dict[str, str] = {
    "pelvis": "root",
    "chest": "thorax",
    "head": "head",
    "left_foot": "lfoot",
    "right_foot": "rfoot",
    "left_collar": "lclavicle",
    "right_collar": "rclavicle",
}

REQUIRED = tuple(f"{side}_{part}" for side in ("left", "right") for part in ("hip", "knee", "ankle"))
_PARTS = ("hip", "knee", "ankle", "toe", "collar", "shoulder", "elbow", "wrist")
_ABOVE = {"knee": "hip", "ankle": "knee", "toe": "ankle", "elbow": "shoulder", "wrist": "elbow"}
"""Where several joints have a name, as a hand and a glove may, it is the one on the limb."""
MARKS = tuple(f"{side}_{part}" for side in ("left", "right") for part in _PARTS) + ("head", "neck")


def mapped(joints: Mapping[str, str], names: Sequence[str]) -> dict[str, int]:
    """Landmarks from a map of our joint names to those of a file; `left_foot` is our name of the left toe.

    Raises:
        InvalidInputError: a name of ours that does not exist, or one of theirs that the file does not have.
    """
    ours = {m: m for m in MARKS} | {"left_foot": "left_toe", "right_foot": "right_toe"}
    unused = ("pelvis", "spine1", "spine2", "spine3")
    plain = {"".join(words_of(name)): i for i, name in reversed(list(enumerate(names)))}
    out: dict[str, int] = {}
    for mark, theirs in joints.items():
        if mark not in ours and mark not in unused:
            raise InvalidInputError(
                f"the joint map has {mark!r}, which is no joint of ours (the map goes from our names to the file's)",
                field="joints",
                allowed=", ".join(ours),
            )
        index = names.index(theirs) if theirs in names else plain.get("".join(words_of(theirs)))
        if index is None:
            raise InvalidInputError(
                f"the joint map says that {mark} is {theirs!r}, which the file does not have",
                field="joints",
                allowed=", ".join(names[:60]),
            )
        if mark in ours:
            out[ours[mark]] = index
    return out


def find_landmarks(
    names: tuple[str, ...],
    parents: tuple[int, ...],
    joints: Mapping[str, str] | None = None,
    ends: bool = False,
) -> dict[str, int]:
    """Index of each landmark (`left_hip`, ..., `head`, `neck`); legs are required, the others come where found.

    Args:
        joints: a map of our names to the file's, which goes before what the names say.
        ends: a joint is the far end of the bone it is called after (Acclaim).

    Raises:
        InvalidInputError: a hip, knee or ankle cannot be told by its name.
    """
    given = mapped(joints, names) if joints else {}
    if ends and {ACCLAIM[mark] for mark in REQUIRED} <= set(names):
        return {mark: names.index(bone) for mark, bone in ACCLAIM.items() if bone in names} | given
    before, after = shared_words(names)
    bare = [normalise(name, before, after) for name in names]
    found: dict[str, int] = {}
    for side in ("left", "right"):
        for part in _PARTS:
            for alias in ALIASES[part]:
                hits = [i for i, b in enumerate(bare) if b == (side, alias)]
                if hits:
                    above = found.get(f"{side}_{_ABOVE[part]}") if part in _ABOVE else None
                    found[f"{side}_{part}"] = next((i for i in hits if _hangs_on(i, above, parents)), hits[0])
                    break
        _settle_side(side, found, bare, parents)
    for part in ("head", "neck"):
        for alias in ALIASES[part]:
            hits = [i for i, b in enumerate(bare) if b == ("", alias)]
            if hits:
                found[part] = hits[0]
                break
    if ends:
        found = _far_ends(found, parents)
    found |= given
    missing = [m for m in REQUIRED if m not in found]
    if missing:
        known = ", ".join(f"{mark} is {names[i]}" for mark, i in found.items()) or "none"
        raise InvalidInputError(
            f"cannot find {', '.join(missing)}; found: {known}; joints of the file: {', '.join(names[:60])}",
            field="skeleton",
            allowed="joint names that say hip/thigh, knee/shin/calf, ankle/foot with a side, or a map of ours to"
            ' theirs such as {"left_hip": "Bone_12"} (--joints FILE)',
        )
    return found


def _hangs_on(joint: int, above: int | None, parents: tuple[int, ...]) -> bool:
    """Whether `above` is among the ancestors of a joint."""
    while above is not None and joint >= 0:
        joint = parents[joint]
        if joint == above:
            return True
    return False


def _far_ends(found: dict[str, int], parents: tuple[int, ...]) -> dict[str, int]:
    """Landmarks of a skeleton whose joints are the far ends of its bones: a bone begins where its parent ends."""
    out = {mark: max(parents[i], 0) for mark, i in found.items()}
    for side in ("left", "right"):
        for mark, bone in ((f"{side}_ankle", f"{side}_knee"), (f"{side}_wrist", f"{side}_elbow")):
            if mark not in out and bone in found:
                out[mark] = found[bone]
    return out


def _settle_side(side: str, found: dict[str, int], bare: list[tuple[str, str]], parents: tuple[int, ...]) -> None:
    """Resolve names that mean different joints in different conventions by the order along the chain."""
    shoulder, collar, elbow = (found.get(f"{side}_{p}") for p in ("shoulder", "collar", "elbow"))
    if shoulder is not None and shoulder == collar:
        del found[f"{side}_collar"]
        # 'shoulder' is the upper arm where nothing lies between it and the elbow, else the clavicle.
        between = parents[elbow] if elbow is not None else shoulder
        if between != shoulder and between >= 0 and parents[between] == shoulder:
            found[f"{side}_collar"], found[f"{side}_shoulder"] = shoulder, between
        elif parents[shoulder] >= 0 and bare[parents[shoulder]][0] == side:
            found[f"{side}_collar"] = parents[shoulder]
    if (side, "ankle") in bare and (side, "foot") in bare:
        # Both names present: the foot is what lies beyond the ankle (HumanML3D, SMPL).
        found[f"{side}_ankle"] = bare.index((side, "ankle"))
        found[f"{side}_toe"] = bare.index((side, "foot"))
    ankle = found.get(f"{side}_ankle")
    if ankle is not None and f"{side}_toe" not in found:
        children = [i for i, p in enumerate(parents) if p == ankle]
        if children:
            found[f"{side}_toe"] = children[0]


def find_segments(
    names: tuple[str, ...], parents: tuple[int, ...], marks: Mapping[str, int], ends: bool = False
) -> dict[str, int]:
    """Joint whose world rotation is each segment's: pelvis, chest, head, left/right foot and collar where found.

    Raises:
        InvalidInputError: the legs do not hang together.
    """
    if ends and {ACCLAIM[mark] for mark in REQUIRED} <= set(names):
        found = {s: names.index(b) for s, b in ACCLAIM_SEGMENTS.items() if b in names}
        return {f"{side}_foot": marks[f"{side}_ankle"] for side in ("left", "right")} | found
    out: dict[str, int] = {"pelvis": common_ancestor(parents, marks["left_hip"], marks["right_hip"])}
    if out["pelvis"] < 0:
        raise InvalidInputError("the two legs hang on different roots", field="skeleton")
    if "left_shoulder" in marks and "right_shoulder" in marks:
        chest = common_ancestor(parents, marks["left_shoulder"], marks["right_shoulder"])
        if chest >= 0:
            out["chest"] = chest
    if "head" in marks or "neck" in marks:
        out["head"] = marks.get("head", marks.get("neck", 0))
    for side in ("left", "right"):
        # Where joints are far ends, the foot is the bone that begins at the ankle.
        below = [i for i, p in enumerate(parents) if p == marks[f"{side}_ankle"]] if ends else []
        out[f"{side}_foot"] = below[0] if below else marks[f"{side}_ankle"]
        if f"{side}_collar" in marks:
            out[f"{side}_collar"] = marks[f"{side}_collar"]
    return out


def common_ancestor(parents: tuple[int, ...], a: int, b: int) -> int:
    """The nearest joint above two joints; -1 where they hang on different roots."""
    chain = set()
    while a >= 0:
        chain.add(a)
        a = parents[a]
    while b >= 0 and b not in chain:
        b = parents[b]
    return b


def leg_length(positions: Array, marks: Mapping[str, int]) -> float:
    """Thigh plus shank, mean of both sides over the frames, in the unit of positions (T, J, 3)."""
    total = 0.0
    for side in ("left", "right"):
        hip, knee, ankle = (positions[:, marks[f"{side}_{p}"]] for p in ("hip", "knee", "ankle"))
        total += float(np.mean(np.linalg.norm(hip - knee, axis=-1) + np.linalg.norm(knee - ankle, axis=-1)))
    return total / 2
