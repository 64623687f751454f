"""Triangle meshes of simple solids with a normal a vertex; metres, triangles anticlockwise from outside."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
AROUND = 20
"""Corners of a circle."""


@dataclass(frozen=True)
class Mesh:
    """Triangles. vertices_m and normals: (V, 3); faces: (F, 3) indices."""

    vertices_m: Array
    normals: Array
    faces: npt.NDArray[np.int64]

    def moved(self, position_m: npt.ArrayLike) -> Mesh:
        """The same mesh somewhere else."""
        return Mesh(self.vertices_m + np.asarray(position_m, dtype=np.float64), self.normals, self.faces)

    def turned(self, rotation: Array) -> Mesh:
        """The same mesh turned about the origin by a rotation matrix (3, 3)."""
        return Mesh(self.vertices_m @ rotation.T, self.normals @ rotation.T, self.faces)


def joined(meshes: list[Mesh]) -> Mesh:
    """Several meshes as one."""
    starts = np.cumsum([0, *(len(mesh.vertices_m) for mesh in meshes)])
    return Mesh(
        np.concatenate([mesh.vertices_m for mesh in meshes]),
        np.concatenate([mesh.normals for mesh in meshes]),
        np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts[:-1], strict=True)]),
    )


def revolve(x_m: Array, r_m: Array, axis: npt.ArrayLike, around: int = AROUND) -> Mesh:
    """The outline r(x), both (N,), turned about the unit vector `axis` through the origin."""
    axis = np.asarray(axis, dtype=np.float64)
    helper = np.array([0.0, 0.0, 1.0]) if abs(axis[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    u = np.cross(axis, helper)
    u /= np.linalg.norm(u)
    v = np.cross(axis, u)
    angle = np.arange(around) * (2 * np.pi / around)
    radial = np.cos(angle)[:, None] * u + np.sin(angle)[:, None] * v
    slope_x, slope_r = np.gradient(x_m), np.gradient(r_m)
    normals = slope_x[:, None, None] * radial - slope_r[:, None, None] * axis
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-9)
    vertices = x_m[:, None, None] * axis + r_m[:, None, None] * radial
    ring, spoke = np.meshgrid(np.arange(len(x_m) - 1), np.arange(around), indexing="ij")
    a, b = ring * around + spoke, ring * around + (spoke + 1) % around
    faces = np.concatenate([np.stack([a, b, a + around], -1), np.stack([b, b + around, a + around], -1)])
    return Mesh(vertices.reshape(-1, 3), normals.reshape(-1, 3), faces.reshape(-1, 3))


def limb(outline: npt.ArrayLike, end_m: npt.ArrayLike, scale_m: float, around: int = 14) -> Mesh:
    """A limb from the origin to `end_m` (3,), with round ends.

    Args:
        outline: (N, 2) places along the limb (0 to 1) and radii as fractions of `scale_m`.
    """
    end = np.asarray(end_m, dtype=np.float64)
    length = float(np.linalg.norm(end))
    places, radii = np.asarray(outline, dtype=np.float64).T
    along = np.linspace(places[0], places[-1], 13)
    radius = np.interp(along, places, radii) * scale_m
    cap = np.linspace(0.0, np.pi / 2, 6)[1:]
    x = np.concatenate(
        [
            (along[0] * length - radius[0] * np.sin(cap))[::-1],
            along * length,
            along[-1] * length + radius[-1] * np.sin(cap),
        ]
    )
    r = np.concatenate([(radius[0] * np.cos(cap))[::-1], radius, radius[-1] * np.cos(cap)])
    return revolve(x, np.maximum(r, 1e-5), end / length, around)


def ellipsoid(half_m: npt.ArrayLike, around: int = AROUND) -> Mesh:
    """About the origin, half axes (3,)."""
    half = np.asarray(half_m, dtype=np.float64)
    angle = np.linspace(-np.pi / 2, np.pi / 2, around // 2 + 1)
    ball = revolve(np.sin(angle), np.maximum(np.cos(angle), 1e-5), (0.0, 0.0, 1.0), around)
    normals = ball.vertices_m / half
    return Mesh(ball.vertices_m * half, normals / np.linalg.norm(normals, axis=-1, keepdims=True), ball.faces)


def box(half_m: npt.ArrayLike) -> Mesh:
    """About the origin, half sizes (3,), flat sides."""
    half = np.asarray(half_m, dtype=np.float64)
    vertices, normals = [], []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            out, across = np.eye(3)[axis] * sign, np.eye(3)[(axis + 1) % 3]
            along = np.cross(out, across)
            for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
                vertices.append((out + a * across + b * along) * half)
                normals.append(out)
    first = np.arange(6)[:, None] * 4
    faces = np.concatenate([first + [0, 1, 2], first + [0, 2, 3]])
    return Mesh(np.array(vertices), np.array(normals), faces)


def cylinder(radius_m: float, half_length_m: float, around: int = AROUND) -> Mesh:
    """About the origin along Z, flat ends."""
    x = np.array([-half_length_m, half_length_m])
    side = revolve(x, np.full(2, radius_m), (0.0, 0.0, 1.0), around)
    radial = side.normals * [1.0, 1.0, 0.0]
    parts = [Mesh(side.vertices_m, radial / np.linalg.norm(radial, axis=-1, keepdims=True), side.faces)]
    ring = side.vertices_m[:around] * [1.0, 1.0, 0.0]
    spoke = np.arange(1, around - 1)
    fan = np.stack([np.zeros_like(spoke), spoke, spoke + 1], axis=-1)
    upward = float(np.cross(ring[1] - ring[0], ring[2] - ring[0])[2]) > 0
    for sign in (-1.0, 1.0):
        end = ring + [0.0, 0.0, sign * half_length_m]
        parts.append(Mesh(end, np.tile([0.0, 0.0, sign], (around, 1)), fan if upward == (sign > 0) else fan[:, ::-1]))
    return joined(parts)


def capsule(radius_m: float, start_m: npt.ArrayLike, end_m: npt.ArrayLike, around: int = AROUND) -> Mesh:
    """A cylinder with round ends; its axis runs from `start_m` to `end_m` (3,)."""
    start, end = np.asarray(start_m, dtype=np.float64), np.asarray(end_m, dtype=np.float64)
    return limb(((0.0, radius_m), (1.0, radius_m)), end - start, 1.0, around).moved(start)
