"""Rotations: quaternions wxyz, matrices and the continuous 6D form of Zhou et al. (2019).

All functions work on any leading batch shape and never modify their arguments. A quaternion or matrix
turns coordinates of the child (body) frame into those of the parent (world) frame.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def normalize(v: npt.ArrayLike, eps: float = 1e-9) -> Array:
    """Unit vectors along the last axis; a vector shorter than `eps` is divided by `eps`."""
    a = np.asarray(v, dtype=np.float64)
    return np.asarray(a / np.maximum(np.sqrt(np.add.reduce(a * a, axis=-1, keepdims=True)), eps))


def cross(a: npt.NDArray[np.floating], b: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
    """Cross product along the last axis, what np.cross gives, several times faster for small batches."""
    out = np.empty(a.shape if a.shape == b.shape else np.broadcast_shapes(a.shape, b.shape), np.result_type(a, b))
    a0, a1, a2 = a[..., 0], a[..., 1], a[..., 2]
    b0, b1, b2 = b[..., 0], b[..., 1], b[..., 2]
    out[..., 0] = a1 * b2 - a2 * b1
    out[..., 1] = a2 * b0 - a0 * b2
    out[..., 2] = a0 * b1 - a1 * b0
    return out


def matrix_from_6d(r6: npt.ArrayLike) -> Array:
    """(..., 6) the first two columns of a rotation matrix -> (..., 3, 3), by Gram-Schmidt."""
    a = np.asarray(r6, dtype=np.float64)
    x = normalize(a[..., :3])
    y = a[..., 3:] - np.sum(x * a[..., 3:], axis=-1, keepdims=True) * x
    y = normalize(y)
    return np.stack([x, y, np.cross(x, y)], axis=-1)


def matrix_to_6d(m: npt.ArrayLike) -> Array:
    """(..., 3, 3) -> (..., 6): the first column, then the second."""
    a = np.asarray(m, dtype=np.float64)
    return np.concatenate([a[..., :, 0], a[..., :, 1]], axis=-1)


def quat_from_matrix(m: npt.ArrayLike) -> Array:
    """(..., 3, 3) -> (..., 4) wxyz with w >= 0 (Shepperd's method, the largest component first)."""
    a = np.asarray(m, dtype=np.float64)
    m00, m11, m22 = a[..., 0, 0], a[..., 1, 1], a[..., 2, 2]
    c = np.empty(a.shape[:-2] + (4, 4))  # candidate, component
    c[..., 0, 0] = 1 + m00 + m11 + m22
    c[..., 1, 1] = 1 + m00 - m11 - m22
    c[..., 2, 2] = 1 - m00 + m11 - m22
    c[..., 3, 3] = 1 - m00 - m11 + m22
    c[..., 0, 1] = c[..., 1, 0] = a[..., 2, 1] - a[..., 1, 2]
    c[..., 0, 2] = c[..., 2, 0] = a[..., 0, 2] - a[..., 2, 0]
    c[..., 0, 3] = c[..., 3, 0] = a[..., 1, 0] - a[..., 0, 1]
    c[..., 1, 2] = c[..., 2, 1] = a[..., 0, 1] + a[..., 1, 0]
    c[..., 1, 3] = c[..., 3, 1] = a[..., 0, 2] + a[..., 2, 0]
    c[..., 2, 3] = c[..., 3, 2] = a[..., 1, 2] + a[..., 2, 1]
    diagonal = np.diagonal(c, axis1=-2, axis2=-1)
    best = np.argmax(diagonal, axis=-1)
    q = np.take_along_axis(c, best[..., None, None], axis=-2)[..., 0, :]
    q = normalize(q)
    return np.where(q[..., :1] < 0, -q, q)


def matrix_from_quat(q: npt.ArrayLike) -> Array:
    """(..., 4) wxyz -> (..., 3, 3)."""
    q = normalize(q)
    w, x, y, z = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    out = np.empty(q.shape[:-1] + (3, 3))
    out[..., 0, 0], out[..., 0, 1], out[..., 0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    out[..., 1, 0], out[..., 1, 1], out[..., 1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    out[..., 2, 0], out[..., 2, 1], out[..., 2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    return out


def quat_mul(a: npt.ArrayLike, b: npt.ArrayLike) -> Array:
    """Hamilton product of wxyz quaternions: first `b`, then `a`."""
    aw, ax, ay, az = np.moveaxis(np.asarray(a, dtype=np.float64), -1, 0)
    bw, bx, by, bz = np.moveaxis(np.asarray(b, dtype=np.float64), -1, 0)
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=-1,
    )


def quat_conj(q: npt.ArrayLike) -> Array:
    """Conjugate, the inverse of a unit quaternion."""
    return np.asarray(q, dtype=np.float64) * np.array([1.0, -1.0, -1.0, -1.0])


def quat_apply(q: npt.ArrayLike, v: npt.ArrayLike) -> Array:
    """Rotate vectors (..., 3) by unit quaternions (..., 4)."""
    q, v = np.asarray(q, dtype=np.float64), np.asarray(v, dtype=np.float64)
    u = q[..., 1:]
    t = 2.0 * np.cross(u, v)
    return v + q[..., :1] * t + np.cross(u, t)


def matrix_from_axis_angle(axis: npt.ArrayLike, angle: npt.ArrayLike) -> Array:
    """Unit axes (..., 3) and angles (...) in radians -> (..., 3, 3), Rodrigues' formula."""
    axis = np.asarray(axis, dtype=np.float64)
    angle = np.asarray(angle, dtype=np.float64)[..., None, None]
    x, y, z = axis[..., 0], axis[..., 1], axis[..., 2]
    k = np.zeros(axis.shape[:-1] + (3, 3))
    k[..., 0, 1], k[..., 0, 2], k[..., 1, 2] = -z, y, -x
    k[..., 1, 0], k[..., 2, 0], k[..., 2, 1] = z, -y, x
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * (k @ k)


def matrix_from_rotvec(rotvec: npt.ArrayLike) -> Array:
    """Rotation vectors (..., 3), axis x angle in radians -> (..., 3, 3)."""
    v = np.asarray(rotvec, dtype=np.float64)
    return matrix_from_axis_angle(normalize(v, 1e-12), np.linalg.norm(v, axis=-1))


def rotvec_from_matrix(m: npt.ArrayLike) -> Array:
    """(..., 3, 3) -> rotation vectors (..., 3) with an angle in [0, pi]."""
    q = quat_from_matrix(m)
    s = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(s, q[..., :1])
    return q[..., 1:] * np.where(s > 1e-9, angle / np.maximum(s, 1e-9), 2.0)


def matrix_between(a: npt.ArrayLike, b: npt.ArrayLike) -> Array:
    """Smallest rotation (..., 3, 3) that turns direction `a` into `b`; for opposite ones, about any normal of `a`."""
    a, b = normalize(a), normalize(b)
    if a.shape != b.shape:
        a, b = np.broadcast_arrays(a, b)
    dot = np.sum(a * b, axis=-1)
    axis = cross(a, b)
    angle = np.arctan2(np.sqrt(np.add.reduce(axis * axis, axis=-1)), dot)
    opposite = (dot < -1 + 1e-8)[..., None]
    if opposite.any():
        helper = np.where(np.abs(a[..., :1]) < 0.8, np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
        axis = np.where(opposite, cross(a, helper), axis)
    return matrix_from_axis_angle(normalize(axis, 1e-12), angle)


def quat_slerp(a: npt.ArrayLike, b: npt.ArrayLike, t: npt.ArrayLike) -> Array:
    """Spherical interpolation from `a` (t=0) to `b` (t=1) along the shorter arc; `t` broadcasts to (...)."""
    a, b = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    t = np.asarray(t, dtype=np.float64)[..., None]
    dot = np.sum(a * b, axis=-1, keepdims=True)
    b = np.where(dot < 0, -b, b)
    theta = np.arccos(np.clip(np.abs(dot), 0.0, 1.0))
    s = np.sin(theta)
    near = s < 1e-6
    safe = np.where(near, 1.0, s)
    wa = np.where(near, 1 - t, np.sin((1 - t) * theta) / safe)
    wb = np.where(near, t, np.sin(t * theta) / safe)
    return normalize(wa * a + wb * b)


def matrix_about_z(angle: npt.ArrayLike) -> Array:
    """Rotation (..., 3, 3) about +Z by `angle` radians."""
    angle = np.asarray(angle, dtype=np.float64)
    return matrix_from_axis_angle(np.broadcast_to([0.0, 0.0, 1.0], angle.shape + (3,)), angle)


def wrap_angle(angle: npt.ArrayLike) -> Array:
    """Angle wrapped into [-pi, pi), modulo 2 pi."""
    return (np.asarray(angle, dtype=np.float64) + np.pi) % (2 * np.pi) - np.pi
