"""Anatomical landmarks of any reasonable skeleton, found by joint names and by the shape of the tree."""

from __future__ import annotations

import re

import numpy as np

from shared.errors import InvalidInputError
from shared.motion.io.raw import Array

# Names are compared in lower case without separators, prefixes, side words or digits at the end.
# For each landmark the aliases come in order of preference.
ALIASES: dict[str, tuple[str, ...]] = {
    "hip": ("upleg", "thigh", "hip", "upperleg", "femurstart", "hipjoint"),
    "knee": ("leg", "calf", "knee", "shin", "lowerleg", "lowleg"),
    "ankle": ("foot", "ankle"),
    "toe": ("toebase", "toe", "ball", "toes", "foottoe", "footend"),
    "collar": ("shoulder", "clavicle", "collar", "clav"),
    "shoulder": ("arm", "upperarm", "shoulder", "shldr", "uparm"),
    "elbow": ("forearm", "elbow", "lowerarm", "lowarm"),
    "wrist": ("hand", "wrist"),
    "head": ("head",),
    "neck": ("neck", "lowerneck", "necktwist"),
}

_PREFIXES = ("ccbase", "mixamorig", "bip", "def", "valvebiped", "human", "rokoko")

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

_SIDE_LETTER = re.compile(
    r"^([lr])(hip|thigh|shin|foot|toe|shldr|collar|forearm|hand|knee|ankle|buttock|shoulder|elbow|wrist)"
)

REQUIRED = tuple(f"{side}_{part}" for side in ("left", "right") for part in ("hip", "knee", "ankle"))


def normalise(name: str) -> tuple[str, str]:
    """(side, bare name): side is 'left', 'right' or ''."""
    words = re.sub(r"([a-z])([A-Z])", r"\1 \2", name.split(":")[-1])
    parts = [p.lower() for p in re.split(r"[\s_\-.]+", words) if p]
    side = ""
    kept = []
    for part in parts:
        if part in ("l", "left") and not side:
            side = "left"
        elif part in ("r", "right") and not side:
            side = "right"
        else:
            kept.append(part)
    bare = re.sub(r"\d+$", "", "".join(kept))
    for prefix in _PREFIXES:
        if bare.startswith(prefix) and len(bare) > len(prefix) + 1:
            bare = bare[len(prefix) :]
    if not side:
        match = re.match(r"^(left|right)(.+)$", bare) or _SIDE_LETTER.match(bare)
        if match:
            side = "left" if match.group(1)[0] == "l" else "right"
            bare = bare[len(match.group(1)) :]
    return side, bare


def find_landmarks(names: tuple[str, ...], parents: tuple[int, ...]) -> dict[str, int]:
    """Index of each landmark (`left_hip`, ..., `head`, `neck`); legs are required, the others come where found.

    Raises:
        InvalidInputError: a hip, knee or ankle cannot be told by its name.
    """
    if "lfemur" in names and "lhipjoint" in names:
        return {mark: names.index(bone) for mark, bone in ACCLAIM.items() if bone in names}
    bare = [normalise(n) for n in names]
    found: dict[str, int] = {}
    for side in ("left", "right"):
        for part in ("hip", "knee", "ankle", "toe", "collar", "shoulder", "elbow", "wrist"):
            for alias in ALIASES[part]:
                hits = [i for i, b in enumerate(bare) if b == (side, alias)]
                if hits:
                    found[f"{side}_{part}"] = hits[0]
                    break
        _settle_side(side, found, bare, names, parents)
    for part in ("head", "neck"):
        for alias in ALIASES[part]:
            hits = [i for i, b in enumerate(bare) if b == ("", alias)]
            if hits:
                found[part] = hits[0]
                break
    missing = [m for m in REQUIRED if m not in found]
    if missing:
        raise InvalidInputError(
            f"cannot find {', '.join(missing)} among the joints {', '.join(names[:40])}",
            field="skeleton",
            allowed="joint names that say hip/thigh, knee/shin/calf, ankle/foot with a side",
        )
    return found


def _settle_side(
    side: str, found: dict[str, int], bare: list[tuple[str, str]], names: tuple[str, ...], parents: tuple[int, ...]
) -> None:
    """Resolve names that mean different joints in different conventions by the order along the chain."""
    shoulder, collar, elbow = (found.get(f"{side}_{p}") for p in ("shoulder", "collar", "elbow"))
    if shoulder is not None and shoulder == collar:
        del found[f"{side}_collar"]
        # 'shoulder' is the upper arm where nothing lies between it and the elbow, else the clavicle.
        between = parents[elbow] if elbow is not None else shoulder
        if between != shoulder and parents[between] == shoulder:
            found[f"{side}_collar"], found[f"{side}_shoulder"] = shoulder, between
        elif parents[shoulder] >= 0 and normalise(names[parents[shoulder]])[0] == side:
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
    names: tuple[str, ...], parents: tuple[int, ...], marks: dict[str, int], offsets: Array
) -> dict[str, int]:
    """Joint whose world rotation is each segment's: pelvis, chest, head, left/right foot and collar where found."""
    if "lfemur" in names and "lhipjoint" in names:
        return {s: names.index(b) for s, b in ACCLAIM_SEGMENTS.items() if b in names}
    out: dict[str, int] = {"pelvis": _common_ancestor(parents, marks["left_hip"], marks["right_hip"])}
    if "left_shoulder" in marks and "right_shoulder" in marks:
        out["chest"] = _common_ancestor(parents, marks["left_shoulder"], marks["right_shoulder"])
    if "head" in marks or "neck" in marks:
        out["head"] = marks.get("head", marks.get("neck", 0))
    for side in ("left", "right"):
        out[f"{side}_foot"] = marks[f"{side}_ankle"]
        if f"{side}_collar" in marks:
            out[f"{side}_collar"] = marks[f"{side}_collar"]
    return out


def _common_ancestor(parents: tuple[int, ...], a: int, b: int) -> int:
    chain = set()
    while a >= 0:
        chain.add(a)
        a = parents[a]
    while b not in chain:
        b = parents[b]
    return b


def leg_length(positions: Array, marks: dict[str, int]) -> float:
    """Thigh plus shank, mean of both sides over the frames, in the unit of positions (T, J, 3)."""
    total = 0.0
    for side in ("left", "right"):
        hip, knee, ankle = (positions[:, marks[f"{side}_{p}"]] for p in ("hip", "knee", "ankle"))
        total += float(np.mean(np.linalg.norm(hip - knee, axis=-1) + np.linalg.norm(knee - ankle, axis=-1)))
    return total / 2
