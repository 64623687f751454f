"""One walk of 90 frames, written as a BVH in the many ways exporters write it."""

from __future__ import annotations

import functools
import re
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from shared.motion.body import Array

FRAMES = 90
WALKED_M = 3.26
"""Way of the hips in the file: 89 steps of 11/3 cm."""

JOINTS: tuple[tuple[str, str, tuple[float, float, float]], ...] = (
    ("Hips", "", (0, 0, 0)),
    ("Spine", "Hips", (0, 12, 0)),
    ("Chest", "Spine", (0, 22, 0)),
    ("Neck", "Chest", (0, 20, 0)),
    ("Head", "Neck", (0, 10, 2)),
    ("LeftShoulder", "Chest", (5, 16, 0)),
    ("LeftArm", "LeftShoulder", (12, 0, 0)),
    ("LeftForeArm", "LeftArm", (28, 0, 0)),
    ("LeftHand", "LeftForeArm", (25, 0, 0)),
    ("RightShoulder", "Chest", (-5, 16, 0)),
    ("RightArm", "RightShoulder", (-12, 0, 0)),
    ("RightForeArm", "RightArm", (-28, 0, 0)),
    ("RightHand", "RightForeArm", (-25, 0, 0)),
    ("LeftUpLeg", "Hips", (9, -5, 0)),
    ("LeftLeg", "LeftUpLeg", (0, -41, 0)),
    ("LeftFoot", "LeftLeg", (0, -40, 0)),
    ("LeftToeBase", "LeftFoot", (0, -7, 13)),
    ("RightUpLeg", "Hips", (-9, -5, 0)),
    ("RightLeg", "RightUpLeg", (0, -41, 0)),
    ("RightFoot", "RightLeg", (0, -40, 0)),
    ("RightToeBase", "RightFoot", (0, -7, 13)),
)
Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Y up to Z up: a quarter turn about X."""

X_UP = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Y up to X up: a quarter turn about -Z."""


def local_rotations() -> dict[str, Array]:
    """(90, 3, 3) rotation of each joint that turns in the walk, Y up, facing +Z."""

    def about_x(degrees: Array) -> Rotation:
        return Rotation.from_euler("x", degrees[:, None], degrees=True)

    phase = 2 * np.pi * np.arange(FRAMES) / 30.0
    out = {}
    for side, at in (("Left", phase), ("Right", phase + np.pi)):
        swing = np.sin(at)
        out[f"{side}UpLeg"] = about_x(-24 * swing).as_matrix()
        out[f"{side}Leg"] = about_x(14 + 14 * np.cos(at)).as_matrix()
        down = -75.0 if side == "Left" else 75.0
        arm = about_x(14 * swing) * Rotation.from_euler("z", down, degrees=True)
        out[f"{side}Arm"] = arm.as_matrix()
    return out


def hips() -> Array:
    """(90, 3) path of the hips in centimetres, Y up."""
    k = np.arange(FRAMES)
    return np.stack([0.0 * k, 90.0 + 1.5 * np.cos(4 * np.pi * k / 30.0), k * 11 / 3], axis=-1)


def along_bones() -> dict[str, Array]:
    """Axes (3, 3) of each joint in the zero pose as animation programs give them to bones: Y along the bone."""
    offsets = {joint: np.array(offset, dtype=float) for joint, _, offset in JOINTS}
    first = {parent: joint for joint, parent, _ in reversed(JOINTS)}
    out = {}
    for joint in offsets:
        along = offsets[first.get(joint, joint)]
        y = along / np.linalg.norm(along)
        x = np.cross(y, [0.0, 0.3, 1.0])
        x /= np.linalg.norm(x)
        out[joint] = np.stack([x, y, np.cross(x, y)], axis=1)
    return out


@dataclass
class Spelling:
    """How the walk is written.

    Attributes:
        names: new names of joints.
        turn: rotation of the whole file's axes; `rest` of the zero pose's, where the root's rotation makes up for it.
        scale: file units per centimetre.
        moving: every joint has position channels; without_offsets: and the bones stand only there.
        added: the position channels of joints below the hips are zero and the offsets hold.
        axes: of each joint in the zero pose, where they are not the file's; offsets and rotations are told in them.
        above: lines of a joint above the hips: its CHANNELS line, its values, and its constant rotation.
    """

    names: Mapping[str, str] | Callable[[str], str] = field(default_factory=dict)
    turn: Array = field(default_factory=lambda: np.eye(3))
    rest: Array | None = None
    scale: float = 1.0
    moving: bool = False
    without_offsets: bool = False
    added: bool = False
    axes: Mapping[str, Array] = field(default_factory=dict)
    above: tuple[str, str, Array] | None = None
    frame_time: str = "0.0333333"

    def name(self, joint: str) -> str:
        return self.names(joint) if callable(self.names) else self.names.get(joint, joint)

    def text(self) -> str:
        """The file."""
        rest = self.turn if self.rest is None else self.rest
        children: dict[str, list[str]] = {}
        offsets: dict[str, Array] = {}
        own: dict[str, Array] = {}
        held: dict[str, Array] = {}
        for joint, parent, offset in JOINTS:
            children.setdefault(parent, []).append(joint)
            own[joint] = self.axes.get(joint, np.eye(3))
            held[joint] = own.get(parent, np.eye(3))
            offsets[joint] = held[joint].T @ rest @ np.array(offset, dtype=float) * self.scale
        order: list[str] = []
        lines = ["HIERARCHY"]

        def emit(joint: str, depth: int) -> None:
            pad = "\t" * depth
            order.append(joint)
            kind = "ROOT" if depth == 0 else "JOINT"
            shown = np.zeros(3) if self.without_offsets else offsets[joint]
            lines.extend([f"{pad}{kind} {self.name(joint)}", pad + "{"])
            lines.append(f"{pad}\tOFFSET " + " ".join(f"{v:.5f}" for v in shown))
            six = joint == "Hips" or self.moving or self.without_offsets or self.added
            moves = "6 Xposition Yposition Zposition" if six else "3"
            lines.append(f"{pad}\tCHANNELS {moves} Zrotation Xrotation Yrotation")
            for child in children.get(joint, []):
                emit(child, depth + 1)
            if joint not in children:
                lines.extend(
                    [f"{pad}\tEnd Site", f"{pad}\t{{", f"{pad}\t\tOFFSET 0.00000 0.00000 0.00000", f"{pad}\t}}"]
                )
            lines.append(pad + "}")

        base = np.eye(3)
        if self.above is not None:
            channels, _, base = self.above
            lines.extend(["ROOT Armature", "{", "\tOFFSET 0 0 0", f"\t{channels}"])
            emit("Hips", 1)
            lines.append("}")
        else:
            emit("Hips", 0)
        rotations = local_rotations()
        columns: list[Array] = []
        for joint in order:
            local = rest @ rotations.get(joint, np.broadcast_to(np.eye(3), (FRAMES, 3, 3))) @ rest.T
            local = held[joint].T @ local @ own[joint]
            if joint == "Hips":
                columns.append((hips() * self.scale) @ self.turn.T @ base)
                local = base.T @ self.turn @ rest.T @ local
            elif self.added:
                columns.append(np.zeros((FRAMES, 3)))
            elif self.moving or self.without_offsets:
                columns.append(np.broadcast_to(offsets[joint], (FRAMES, 3)))
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # at the pole of the angles any of them will do
                columns.append(Rotation.from_matrix(local).as_euler("ZXY", degrees=True))
        rows = np.concatenate(columns, axis=1)
        before = f"{self.above[1]} " if self.above is not None and self.above[1] else ""
        lines += ["MOTION", f"Frames: {FRAMES}", f"Frame Time: {self.frame_time}"]
        lines += [before + " ".join(f"{v:.5f}" for v in row) for row in rows]
        return "\n".join(lines) + "\n"


@functools.cache
def plain() -> str:
    """The walk in plain form."""
    return Spelling().text()


SIX = "CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation"
CAMERA = "ROOT Camera\n{\n\tOFFSET 0 0 0\n\t" + SIX + "\n\tEnd Site\n\t{\n\t\tOFFSET 0 0 10\n\t}\n}\n"


def with_camera(text: str, first: bool = False) -> str:
    """A file with a second root, before or after the person's."""
    head, rows = text.split("Frame Time: 0.0333333\n")
    head = (
        head.replace("HIERARCHY\n", "HIERARCHY\n" + CAMERA) if first else head.replace("MOTION\n", CAMERA + "MOTION\n")
    )
    values = "700 150 -300 0 20 0"
    joined = [f"{values} {row}" if first else f"{row} {values}" for row in rows.strip().splitlines()]
    return head + "Frame Time: 0.0333333\n" + "\n".join(joined) + "\n"


def lines_with(at: str, new: str, text: str | None = None) -> str:
    """The plain file with a pattern replaced once."""
    out, count = re.subn(at, new, plain() if text is None else text, count=1, flags=re.MULTILINE)
    assert count == 1
    return out


def comma(text: str) -> str:
    """Decimal commas."""
    return re.sub(r"(\d)\.(\d)", r"\1,\2", text)
