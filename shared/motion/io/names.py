"""What joint names say: their side, their bare name, and which program's skeleton they are of."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence

_LEFT = ("l", "left", "lft", "lt")
_RIGHT = ("r", "right", "rgt", "rt")
_PREFIX = re.compile(
    r"(cc|base|ccbase|mixamorig\d*|bip\d*|biped\d*|def|org|valve|valvebiped|human|rokoko|newton|j|c|avg|robot|"
    r"character\d*|actor\d*|skeleton\d*|rl|armature)"
)
"""Words that programs put before the name of a joint."""

_SIDE_LETTER = re.compile(
    r"^([lr])(hip|thigh|shin|calf|shank|foot|toe|ball|shldr|collar|clav|forearm|hand|knee|ankle|buttock|shoulder|elbow|"
    r"wrist|femur|tibia|humerus|radius|upleg|lowleg|leg|upperleg|lowerleg|uparm|lowarm|upperarm|lowerarm|uarm|farm|arm)"
)
_LEAST_SHARED = 0.6


def words_of(name: str) -> list[str]:
    """Lower-case words of a name, parted at capitals, blanks, dots, dashes and underscores; namespaces are dropped."""
    name = re.sub(r"^[mf]_avg_", "", name.split(":")[-1].split("|")[-1])
    name = re.sub(r"([a-z0-9])([A-Z])", r"\1 \2", name)
    name = re.sub(r"([A-Z])([A-Z][a-z])", r"\1 \2", name)
    return [w.lower() for w in re.split(r"[\s_\-.]+", name) if w]


def shared_words(names: Sequence[str]) -> tuple[list[str], list[str]]:
    """Words that most of the names begin with, and end with: an exporter's own, such as `Character1_` or `_JNT`."""
    split = [words_of(name) for name in names]
    out: tuple[list[str], list[str]] = ([], [])
    for found, at in zip(out, (0, -1), strict=True):
        rest = [w if at == 0 else w[:] for w in split]
        while True:
            longer = [w for w in rest if len(w) > 1]
            word, count = Counter(w[at] for w in longer).most_common(1)[0] if longer else ("", 0)
            if len(longer) < 6 or count < _LEAST_SHARED * len(rest) or word in (*_LEFT, *_RIGHT, "end"):
                break
            found.append(word)
            rest = [w[1:] if at == 0 else w[:-1] for w in longer if w[at] == word]
    return out[0], out[1][::-1]


def normalise(name: str, before: Sequence[str] = (), after: Sequence[str] = ()) -> tuple[str, str]:
    """(side, bare name): side is 'left', 'right' or ''. `before`, `after`: words shared by all names, to drop."""
    words = words_of(name)
    if before and len(words) > len(before) and words[: len(before)] == list(before):
        words = words[len(before) :]
    if after and len(words) > len(after) and words[-len(after) :] == list(after):
        words = words[: -len(after)]
    while len(words) > 1 and _PREFIX.fullmatch(words[0]):
        words = words[1:]
    # Daz parts a limb's bone into a bending and a twisting one, Auto-Rig Pro calls it stretched.
    words = [word for word in words if word not in ("bend", "stretch")] or words
    side = ""
    kept = []
    for word in words:
        if word in _LEFT and not side:
            side = "left"
        elif word in _RIGHT and not side:
            side = "right"
        else:
            kept.append(word)
    bare = re.sub(r"\d+$", "", "".join(kept))
    glued = re.match(r"^(?:mixamorig|bip|valvebiped|ccbase|def)\d*(.{2,})$", bare)
    if glued:
        bare = glued.group(1)
    if not side:
        match = re.match(r"^(left|right)(.+)$", bare) or _SIDE_LETTER.match(bare)
        if match:
            side = "left" if match.group(1)[0] == "l" else "right"
            bare = bare[len(match.group(1)) :]
    return side, bare


_FAMILIES: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("Mixamo", ("mixamorig",)),
    ("VRoid", (r"\bj_bip_",)),
    ("Character Creator", (r"\bcc_base_",)),
    ("Source", ("valvebiped",)),
    ("3ds Max Biped", (r"\bbip(ed)?\d*[ _.]?[lr]?[ _.]?(pelvis|spine|thigh)",)),
    ("Rigify", (r"\b(def-)?thigh\.l\b", r"\b(def-)?shin\.l\b")),
    ("Unreal", (r"thigh_l\b", r"calf_l\b")),
    ("Daz", (r"\blthighbend\b",)),
    ("Daz", (r"\bl_thigh\b", r"\bl_shin\b")),
    ("Daz or Poser", (r"\blshldr\b",)),
    ("OptiTrack", (r"\bluarm\b", r"\blthigh\b")),
    ("SMPL", (r"(\b|_)l(eft)?_hip\b", r"(\b|_)l(eft)?_knee\b")),
    ("Acclaim", (r"\blfemur\b",)),
    ("Rokoko", (r"leftthigh\b", r"leftshin\b")),
    ("Xsens MVN", (r"leftupperleg\b", r"leftlowerleg\b")),
    ("HumanIK", (r"leftupleg(?![a-z])",)),
    ("hip-knee-ankle", (r"lefthip\b", r"leftknee\b")),
)
"""Skeleton families by what must occur in the names; HumanIK is MotionBuilder's, Perception Neuron's and others'."""


def family(names: Sequence[str]) -> str:
    """The program or convention a skeleton's joints are named after, or 'other'."""
    text = "\n".join(names).lower()
    return next((label for label, patterns in _FAMILIES if all(re.search(p, text) for p in patterns)), "other")
