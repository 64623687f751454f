"""RawMotion: motion as a file has it, in metres with Z up, before it is retargeted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.interpolate import CubicSpline

from shared.errors import InvalidInputError
from shared.motion.io.landmarks import Array, find_landmarks, find_segments
from shared.motion.rotations import matrix_from_6d, matrix_to_6d


class LeftOutError(InvalidInputError):
    """The file is sound, but there is nothing in it to use: no motion, or too short a one."""


@dataclass(frozen=True)
class RawMotion:
    """Motion of any skeleton. World Z up, metres.

    Attributes:
        names: (J,) joint names as in the file; end sites are called `<parent>_end`.
        parents: (J,) index of each joint's parent, -1 for the root; a parent precedes its children.
        offsets_m: (J, 3) offset from the parent in the file's zero pose, turned to Z up.
        positions_w_m: (T, J, 3).
        rotations_w: (T, J, 3, 3) world rotations relative to the file's zero pose, or None.
        rest_positions_m: (J, 3) joint positions of the zero pose.
        fps: frames per second.
        source: where it was read from, for messages.
        up: the file's vertical axis: 'x', 'y', 'z', or one of them with a minus.
        unit_m: metres in one unit of the file.
        family: the program or convention its joints are named after.
        warnings: what was assumed or passed over in reading, in sentences.
        marks, segments: joints by landmark and by segment where the reader found them; see `landmarks`, `segmented`.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    offsets_m: Array
    positions_w_m: Array
    rotations_w: Array | None
    rest_positions_m: Array
    fps: float
    source: str
    up: str = "z"
    unit_m: float = 1.0
    family: str = "other"
    warnings: tuple[str, ...] = ()
    marks: Mapping[str, int] = field(default_factory=dict)
    segments: Mapping[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.positions_w_m.ndim != 3 or self.positions_w_m.shape[1:] != (len(self.names), 3):
            raise InvalidInputError(
                f"{self.source}: positions have shape {self.positions_w_m.shape}",
                field="positions_w_m",
                allowed=f"(T, {len(self.names)}, 3)",
            )
        if not np.isfinite(self.positions_w_m).all():
            raise InvalidInputError(f"{self.source}: non-finite positions", field="positions_w_m", allowed="finite")

    def __len__(self) -> int:
        return int(self.positions_w_m.shape[0])

    def landmarks(self) -> dict[str, int]:
        """Joint of each landmark; see `find_landmarks`."""
        return dict(self.marks) or find_landmarks(self.names, self.parents)

    def segmented(self) -> dict[str, int]:
        """Joint whose rotation is each segment's; see `find_segments`."""
        return dict(self.segments) or find_segments(self.names, self.parents, self.landmarks())

    def at_rate(self, fps: float) -> RawMotion:
        """The same motion sampled at k / fps seconds (cubic splines; rotations re-made orthonormal)."""
        if abs(self.fps - fps) / fps < 2e-3 or len(self) < 4:
            return replace(self, fps=fps) if len(self) >= 4 else self
        t_in = np.arange(len(self)) / self.fps
        t_out = np.arange(int(np.floor(t_in[-1] * fps + 1e-9)) + 1) / fps
        positions = CubicSpline(t_in, self.positions_w_m)(t_out)
        rotations = None
        if self.rotations_w is not None:
            rotations = matrix_from_6d(CubicSpline(t_in, matrix_to_6d(self.rotations_w))(t_out))
        return replace(self, positions_w_m=positions, rotations_w=rotations, fps=fps)


def accumulate(parents: tuple[int, ...], offsets: Array) -> Array:
    """Zero-pose joint positions (J, 3) from the offsets (J, 3)."""
    out = offsets.copy()
    for joint, parent in enumerate(parents):
        if parent >= 0:
            out[joint] = out[parent] + offsets[joint]
    return out


def compose(
    parents: tuple[int, ...], offsets: Array, root_pos: Array, local: Array, moving: Mapping[int, Array] | None = None
) -> tuple[Array, Array]:
    """World positions (T, J, 3) and rotations (T, J, 3, 3) of a chain given local rotations (T, J, 3, 3).

    `moving`: offsets (T, 3) of joints that move relative to their parent; of a root, its position.
    """
    positions = np.empty(local.shape[:2] + (3,))
    world = np.empty_like(local)
    moving = moving or {}
    for joint, parent in enumerate(parents):
        if parent < 0:
            world[:, joint] = local[:, joint]
            positions[:, joint] = moving.get(joint, root_pos)
        else:
            world[:, joint] = world[:, parent] @ local[:, joint]
            step = moving.get(joint)
            if step is None:
                positions[:, joint] = positions[:, parent] + world[:, parent] @ offsets[joint]
            else:
                positions[:, joint] = positions[:, parent] + np.einsum("tij,tj->ti", world[:, parent], step)
    return positions, world


def euler_matrix(order: str, angles_rad: Array) -> Array:
    """Rotations (..., 3, 3) = R_order[0](a0) R_order[1](a1) ..., for any number of axes out of 'xyz'."""
    out = np.broadcast_to(np.eye(3), angles_rad.shape[:-1] + (3, 3))
    for i, axis in enumerate(order):
        a, b = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
        c, s = np.cos(angles_rad[..., i]), np.sin(angles_rad[..., i])
        m = np.zeros(angles_rad.shape[:-1] + (3, 3))
        m[..., range(3), range(3)] = 1.0
        m[..., a, a], m[..., b, b], m[..., a, b], m[..., b, a] = c, c, -s, s
        out = out @ m
    return np.array(out)
