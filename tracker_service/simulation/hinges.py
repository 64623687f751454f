"""Joint rotations as hinge angles, and back: what the servos of the humanoid can do.

Each joint has 0 to 3 hinges. With E = [a1 a2 a3], a right-handed orthonormal triple in the parent's frame, and Q0 the
joint's rotation at zero angles, a joint's rotation relative to its parent is

    R = Rot(a1, q1) Rot(a2, q2) Rot(a3, q3) Q0 = E X(q1) Y(q2) Z(q3) E^T Q0,

so the angles are the Euler XYZ angles of E^T R Q0^T E; absent hinges are angles that stay zero. Two-hinge joints
have a3 along the bone they swing, so that dropping q3 drops exactly the twist. The gimbal poles (q2 = +-90 deg) are put
where people rarely are: for the shoulder an arm pointing 30 deg behind sideways, or across the chest.

Which joints have how many hinges: knee, elbow and toe 1; hip, ankle, shoulder, the three spine joints and neck 3;
collar 2 (its twist cannot be seen from joint positions); head and wrist 0 (their rotation cannot be seen either).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shared.motion.rotations import matrix_between
from shared.motion.skeleton import CANONICAL, Skeleton

Array = npt.NDArray[np.float64]

_FLEXION = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]).T  # columns: Y, X, -Z


@dataclass(frozen=True)
class HingeSpec:
    """The hinges of one joint, see the module's docstring.

    Attributes:
        joint: name of the skeleton's joint.
        count: number of hinges, 0 to 3.
        axes: (3, 3) the triple E, axes as columns, in the parent's frame.
        rest: (3, 3) rotation Q0 at zero angles.
        limits_rad: (count, 2) lowest and highest angle of each hinge.
    """

    joint: str
    count: int
    axes: Array
    rest: Array
    limits_rad: Array


def _mirror(spec: HingeSpec, joint: str) -> HingeSpec:
    """The same joint on the other side: mirrored motion has the same angles. Rotation axes are pseudo-vectors."""
    flip = np.diag([1.0, -1.0, 1.0])
    return HingeSpec(joint, spec.count, -flip @ spec.axes, flip @ spec.rest @ flip, spec.limits_rad)


def _spec(joint: str, axes: Array, limits: list[tuple[float, float]], rest: Array | None = None) -> HingeSpec:
    return HingeSpec(joint, len(limits), axes, np.eye(3) if rest is None else rest, np.array(limits).reshape(-1, 2))


def human_hinges(skeleton: Skeleton = CANONICAL) -> tuple[HingeSpec, ...]:
    """The hinges of a human, one spec for each joint but the root, in the skeleton's order. Limits are generous."""
    back = np.deg2rad(30.0)
    a1 = np.array([-np.sin(back), np.cos(back), 0.0])  # near the left-right axis, turned backward
    a3 = np.array([0.0, 0.0, -1.0])  # along the hanging arm: twist
    shoulder = np.stack([a1, np.cross(a3, a1), a3], axis=-1)
    hanging = matrix_between(np.array([0.0, 1.0, 0.0]), a3)
    bone = skeleton.offsets_m[skeleton.index("left_shoulder")]
    bone = bone / np.linalg.norm(bone)
    up = np.array([0.0, 0.0, 1.0]) - bone[2] * bone
    up /= np.linalg.norm(up)
    collar = np.stack([up, np.cross(bone, up), bone], axis=-1)
    elbow = np.stack([-np.eye(3)[2], np.eye(3)[0], -np.eye(3)[1]], axis=-1)  # -Z: the left forearm bends forward
    spine = [(-0.9, 1.2), (-0.7, 0.7), (-0.9, 0.9)]
    left = {
        "left_hip": _spec("left_hip", _FLEXION, [(-2.7, 1.3), (-0.9, 1.5), (-1.3, 1.3)]),
        "left_knee": _spec("left_knee", _FLEXION, [(-0.1, 2.8)]),
        "left_ankle": _spec("left_ankle", _FLEXION, [(-1.0, 1.3), (-0.8, 0.8), (-0.9, 0.9)]),
        "left_foot": _spec("left_foot", _FLEXION, [(-1.3, 0.9)]),
        "left_collar": _spec("left_collar", collar, [(-0.8, 0.8), (-0.8, 0.8)]),
        "left_shoulder": _spec("left_shoulder", shoulder, [(-3.8, 2.2), (-1.55, 1.55), (-2.6, 2.6)], hanging),
        "left_elbow": _spec("left_elbow", elbow, [(-0.1, 2.8)]),
        "left_wrist": _spec("left_wrist", np.eye(3), []),
        "spine1": _spec("spine1", _FLEXION, spine),
        "spine2": _spec("spine2", _FLEXION, spine),
        "spine3": _spec("spine3", _FLEXION, spine),
        "neck": _spec("neck", _FLEXION, [(-1.2, 1.2), (-1.0, 1.0), (-1.4, 1.4)]),
        "head": _spec("head", np.eye(3), []),
    }
    out = []
    for name in skeleton.names[1:]:
        if name.startswith("right_"):
            out.append(_mirror(left["left_" + name.removeprefix("right_")], name))
        else:
            out.append(left[name])
    return tuple(out)


def depth_first(skeleton: Skeleton) -> list[int]:
    """Joint indices in depth-first order, the root first."""
    order: list[int] = []
    stack = [0]
    while stack:
        joint = stack.pop()
        order.append(joint)
        stack.extend(reversed(skeleton.children(joint)))
    return order


class Hinges:
    """All hinges of a character as arrays. H is the number of hinges, J of joints (the root included).

    Hinges are ordered depth-first over the skeleton's tree, as MuJoCo orders them in qpos.

    Attributes:
        specs: one for each joint but the root.
        joint_of: (H,) index of the joint a hinge belongs to.
        slot_of: (H,) 0, 1 or 2: which of the joint's angles it is.
        lower, upper: (H,) limits in radians.
    """

    def __init__(self, skeleton: Skeleton, specs: tuple[HingeSpec, ...]):
        self.specs = specs
        order = depth_first(skeleton)[1:]
        pairs = [(joint, slot) for joint in order for slot in range(specs[joint - 1].count)]
        self.joint_of = np.array([joint for joint, _ in pairs])
        self.slot_of = np.array([slot for _, slot in pairs])
        limits = np.concatenate([specs[joint - 1].limits_rad for joint in order])
        self.lower, self.upper = limits[:, 0], limits[:, 1]
        self.axes = np.stack([spec.axes for spec in specs])  # (J-1, 3, 3)
        self.axes_t_rest = np.stack([spec.axes.T @ spec.rest for spec in specs])
        self._flat = (self.joint_of - 1) * 3 + self.slot_of
        self._three = np.array([joint for joint, spec in enumerate(specs) if spec.count == 3])
        self._one = np.array([joint for joint, spec in enumerate(specs) if spec.count == 1])

    def __len__(self) -> int:
        return len(self.joint_of)

    @property
    def names(self) -> tuple[str, ...]:
        """(H,) hinge names, `<joint>_<slot>`."""
        return tuple(f"{self.specs[j - 1].joint}_{s}" for j, s in zip(self.joint_of, self.slot_of, strict=True))

    def slots(self, q: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
        """Hinge values (..., H) spread over (..., J-1, 3), absent hinges zero."""
        out = np.zeros(q.shape[:-1] + (len(self.specs) * 3,), dtype=q.dtype)
        out[..., self._flat] = q
        return out.reshape(q.shape[:-1] + (len(self.specs), 3))

    def rotations(self, q: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
        """Local rotations (..., J-1, 3, 3) of the joints but the root, from angles (..., H)."""
        angles = self.slots(q)
        euler = _euler_xyz_matrix(angles)
        dtype = q.dtype
        return np.asarray(self.axes.astype(dtype) @ euler @ self.axes_t_rest.astype(dtype))

    def raw_angles(self, local: npt.NDArray[np.floating]) -> Array:
        """Principal, unclamped angles (..., J-1, 3) of local rotations (..., J, 3, 3); the root's is ignored."""
        m = self.axes.swapaxes(-1, -2) @ np.asarray(local)[..., 1:, :, :] @ self.axes_t_rest.swapaxes(-1, -2)
        b = np.arcsin(np.clip(m[..., 0, 2], -1.0, 1.0))
        a = np.arctan2(-m[..., 1, 2], m[..., 2, 2])
        c = np.arctan2(-m[..., 0, 1], m[..., 0, 0])
        out = np.stack([a, b, c], axis=-1)
        # One hinge: the twist of the rotation about a1, which is what is left of it when the swing is taken away.
        one = m[..., self._one, :, :]
        out[..., self._one, 0] = np.arctan2(one[..., 2, 1] - one[..., 1, 2], one[..., 1, 1] + one[..., 2, 2])
        return out

    def angles(self, local: npt.NDArray[np.floating], previous: Array | None = None) -> Array:
        """Hinge angles (T, H) of a motion's local rotations (T, J, 3, 3), clamped to the limits.

        The same rotation has two Euler triples, each modulo 2 pi. Per frame the one is taken that is nearest to the
        frame before among those within the limits, so a hinge never jumps where the motion does not.

        Args:
            local: rotations relative to the parent.
            previous: (H,) angles at the tick before the first, to go on from; None starts at the principal ones.
        """
        raw = self.raw_angles(local)
        rows = self._three
        lower, upper = self.slots(self.lower)[rows], self.slots(self.upper)[rows]
        last = None if previous is None else self.slots(np.asarray(previous, dtype=np.float64))[rows]
        raw[:, rows] = _continuous(raw[:, rows], lower, upper, last)
        q = raw.reshape(raw.shape[0], -1)[:, self._flat]
        return np.asarray(np.clip(q, self.lower, self.upper))


_WHOLE_TURNS = 2 * np.pi * np.array([[a, 0.0, c] for a in (-1, 0, 1) for c in (-1, 0, 1)])


def _continuous(raw: Array, lower: Array, upper: Array, last: Array | None) -> Array:
    """Choose among equivalent Euler triples (T, R, 3): near the frame before, and within the limits (R, 3)."""
    a, b, c = raw[..., 0], raw[..., 1], raw[..., 2]
    flipped = np.stack([a + np.pi, np.where(b >= 0, np.pi, -np.pi) - b, c + np.pi], -1)
    options = (np.stack([raw, flipped], axis=2)[..., None, :] + _WHOLE_TURNS).reshape(*raw.shape[:2], -1, 3)  # T R K 3
    outside = np.sum(np.maximum(lower[:, None] - options, 0) + np.maximum(options - upper[:, None], 0), axis=-1)
    far, rows, begin = 3.0 * outside, np.arange(raw.shape[1]), 0
    out = np.empty_like(raw)
    gap, cost = np.empty(options.shape[1:]), np.empty(options.shape[1:-1])
    if last is None:
        best = np.argmin(100.0 * outside[0] + np.sum(np.abs(options[0]), -1), axis=-1)
        last = out[0] = options[0, rows, best]
        begin = 1
    for t in range(begin, raw.shape[0]):
        np.subtract(options[t], last[:, None], out=gap)
        np.abs(gap, out=gap)
        np.add.reduce(gap, axis=-1, out=cost)
        cost += far[t]
        last = out[t] = options[t, rows, cost.argmin(axis=-1)]
    return out


def _euler_xyz_matrix(angles: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
    """X(a) Y(b) Z(c) for angles (..., 3) -> (..., 3, 3)."""
    s, co = np.sin(angles), np.cos(angles)
    sa, sb, sc = s[..., 0], s[..., 1], s[..., 2]
    ca, cb, cc = co[..., 0], co[..., 1], co[..., 2]
    out = np.empty(angles.shape[:-1] + (3, 3), dtype=angles.dtype)
    out[..., 0, 0] = cb * cc
    out[..., 0, 1] = -cb * sc
    out[..., 0, 2] = sb
    out[..., 1, 0] = sa * sb * cc + ca * sc
    out[..., 1, 1] = ca * cc - sa * sb * sc
    out[..., 1, 2] = -sa * cb
    out[..., 2, 0] = sa * sc - ca * sb * cc
    out[..., 2, 1] = ca * sb * sc + sa * cc
    out[..., 2, 2] = ca * cb
    return out
