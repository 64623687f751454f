"""RawMotion: motion as a file has it, in metres with Z up, before it is retargeted."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from shared.errors import InvalidInputError
from shared.motion.rotations import matrix_from_6d, matrix_to_6d

Array = npt.NDArray[np.float64]

Y_UP_TO_Z_UP = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""World with Y up and +Z forward -> Z up and +X forward: (x, y, z) becomes (z, x, y)."""

UNITS_M = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "0.45in": 0.0254 / 0.45}
"""Length units seen in files, in metres."""

_LEG_LENGTH_M = 0.82


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
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    offsets_m: Array
    positions_w_m: Array
    rotations_w: Array | None
    rest_positions_m: Array
    fps: float
    source: str

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


def compose(parents: tuple[int, ...], offsets: Array, root_pos: Array, local: Array) -> tuple[Array, Array]:
    """World positions (T, J, 3) and rotations (T, J, 3, 3) of a chain given local rotations (T, J, 3, 3)."""
    positions = np.empty(local.shape[:2] + (3,))
    world = np.empty_like(local)
    for joint, parent in enumerate(parents):
        if parent < 0:
            world[:, joint] = local[:, joint]
            positions[:, joint] = root_pos
        else:
            world[:, joint] = world[:, parent] @ local[:, joint]
            positions[:, joint] = positions[:, parent] + world[:, parent] @ offsets[joint]
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


def guess_unit_m(leg_length: float) -> float:
    """Metres in a file's unit, from the length of thigh and shank in that unit."""
    ratios = {unit: abs(np.log(leg_length * unit / _LEG_LENGTH_M)) for unit in UNITS_M.values()}
    unit = min(ratios, key=lambda u: ratios[u])
    # Off by more than a factor 1.6: an unusual unit; the leg is then taken to be of average length.
    return unit if ratios[unit] < 0.47 else _LEG_LENGTH_M / leg_length


def guess_up_axis(positions: Array, low: npt.NDArray[np.int64], high: npt.NDArray[np.int64]) -> str:
    """'y' or 'z': along which axis the `high` joints are, on average, above the `low` ones. positions (T, J, 3)."""
    span = positions[:, high].mean(axis=1) - positions[:, low].mean(axis=1)
    mean = np.clip(span, 0.0, None).mean(axis=0)
    return "y" if mean[1] >= mean[2] else "z"


def to_z_up(positions: Array, rotations: Array | None, offsets: Array) -> tuple[Array, Array | None, Array]:
    """Turn a Y-up motion and its zero pose to Z up."""
    c = Y_UP_TO_Z_UP
    turned = None if rotations is None else c @ rotations @ c.T
    return positions @ c.T, turned, offsets @ c.T
