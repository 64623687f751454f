"""Captures in the formats of SMPL and Acclaim, made up: arrays and texts, and how they are saved."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from tests.data.walks import local_rotations

FRAMES = 60
_SMPL = {"LeftUpLeg": 1, "RightUpLeg": 2, "LeftLeg": 4, "RightLeg": 5, "LeftArm": 16, "RightArm": 17}


def smpl(up: str = "z", joints: int = 52) -> dict[str, Any]:
    """Arrays of a walk of 60 frames at 30 Hz along +X of a Z-up world, or along +Z of a Y-up one."""
    poses = np.zeros((FRAMES, joints, 3))
    for name, rotations in local_rotations().items():
        poses[:, _SMPL[name]] = Rotation.from_matrix(rotations[:FRAMES]).as_rotvec()
    way, high = 1.1 * np.arange(FRAMES) / 30.0, np.full(FRAMES, 0.95)
    if up == "z":
        # The body's own Z goes to the world's X, its Y to Z.
        poses[:, 0] = Rotation.from_matrix([[0, 0, 1], [1, 0, 0], [0, 1, 0]]).as_rotvec()
        trans = np.stack([way, 0 * way, high], axis=-1)
    else:
        trans = np.stack([0 * way, high, way], axis=-1)
    return {"poses": poses.reshape(FRAMES, -1), "trans": trans, "mocap_framerate": np.float64(30.0)}


def saved(path: Path, arrays: dict[str, Any], **changes: Any) -> Path:
    merged = {k: v for k, v in (arrays | changes).items() if v is not None}
    np.savez(path, **merged)
    return path


ASF_PARENT = {"lhipjoint": "root", "lfemur": "lhipjoint", "ltibia": "lfemur", "lfoot": "ltibia"}
ASF_BONES = {
    "lhipjoint": ("1 -0.3 0", 1.6),
    "lfemur": ("0 -1 0", 7.2),
    "ltibia": ("0 -1 0", 7.3),
    "lfoot": ("0 0 1", 2),
}


def asf(angle: str = "deg", names: dict[str, str] | None = None) -> str:
    """A skeleton of two legs and a spine; one bone's axes are turned by a quarter."""
    names = names or {}
    quarter = "90" if angle == "deg" else f"{np.pi / 2:.8f}"
    parts = [f":units\n length 0.45\n angle {angle}\n:root\n order TX TY TZ RX RY RZ\n axis XYZ\n orientation 0 0 0\n"]
    parts.append(":bonedata\n")
    bones = {"lowerback": ("0 1 0", 8.0, "", "0 0 0"), "head": ("0 1 0", 3.0, "", "0 0 0")}
    links = {"lowerback": "root", "head": "lowerback"}
    for side in "lr":
        for name, (direction, length) in ASF_BONES.items():
            x, y, z = direction.split()
            mine = side + name[1:]
            x = x if side == "l" else str(-float(x))
            dof = "" if "hip" in name else "dof rx\n"
            # A turn about X of axes turned about X is the same turn.
            bones[mine] = (f"{x} {y} {z}", length, dof, f"{quarter} 0 0" if name == "ltibia" else "0 0 0")
            links[mine] = ASF_PARENT[name] if ASF_PARENT[name] == "root" else side + ASF_PARENT[name][1:]
    for name, (direction, length, dof, axis) in bones.items():
        shown = names.get(name, name)
        parts.append(f"begin\n name {shown}\n direction {direction}\n length {length}\n axis {axis} XYZ\n{dof}end\n")
    parts.append(":hierarchy\n begin\n")
    parts += [f" {names.get(p, p)} {names.get(c, c)}\n" for c, p in links.items()]
    return "".join(parts) + " end\n"


def amc(head: str = ":DEGREES", scale: float = 1.0, names: dict[str, str] | None = None) -> str:
    names = names or {}
    lines = ["#!OML:ASF", ":FULLY-SPECIFIED", *head.split("\n")]
    for k in range(FRAMES):
        swing = 25 * np.sin(2 * np.pi * k / 30) * scale
        bend = (15 + 15 * np.cos(2 * np.pi * k / 30)) * scale
        lines += [str(k + 1), f"root 0 16 {k * 0.6:.4f} 0 0 0"]
        lines += [f"{names.get(n, n)} {v:.8f}" for n, v in
                  (("lfemur", -swing), ("rfemur", swing), ("ltibia", bend), ("rtibia", bend),
                   ("lfoot", 0.0), ("rfoot", 0.0))]  # fmt: skip
    return "\n".join(lines) + "\n"


def asf_amc(folder: Path, skeleton: str, motion: str, names: tuple[str, str] = ("01.asf", "01_01.amc")) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / names[0]).write_text(skeleton)
    (folder / names[1]).write_text(motion)
    return folder / names[1]
