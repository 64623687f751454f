"""Joint rotations from joint positions: analytic, stateless, one frame at a time.

Bone directions fix two of a joint's three angles. The third, the twist, is taken from what else is known: the plane in
which an elbow or knee bends, the hips and collars for the trunk, the floor for the sole of the foot. Where a limb is
nearly straight its plane says nothing, so the twist fades to that of the smallest rotation from the T-pose.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from shared.motion.clip import MotionClip
from shared.motion.kinematics import forward_kinematics, local_from_global
from shared.motion.rotations import (
    cross,
    matrix_about_z,
    matrix_between,
    matrix_from_axis_angle,
    matrix_from_rotvec,
    matrix_to_6d,
    normalize,
    rotvec_from_matrix,
    wrap_angle,
)
from shared.motion.skeleton import CANONICAL, Skeleton

Array = npt.NDArray[np.float64]

BEND_SINE_RANGE = (0.1, 0.4)
"""Sine of the bend (6 to 24 degrees) between which a limb's plane starts to count and counts fully."""

ELBOW_TWIST_CENTRE_RAD = np.deg2rad(30.0)
"""Outward twist of the upper arm about which its reachable range is centred, so that the wrap is out of reach."""

ROLL_SCALE_RAD = 0.5
"""Foot rolls of this size and beyond are no longer turned flat on the floor."""

MAX_TOE_EXTENSION_RAD = 0.9

SPINE_SHARES = np.array([1 / 3, 2 / 3])
"""Parts of the bend from pelvis to chest that are in spine1's and spine2's rotation."""

LIMB_AXES = np.array([[0.0, 1.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])
"""Rest axes of the hinges of left knee, right knee, left elbow, right elbow."""

LIMB_TWIST_CENTRES_RAD = np.array([0.0, 0.0, -ELBOW_TWIST_CENTRE_RAD, ELBOW_TWIST_CENTRE_RAD])[:, None]


def _frame(primary: Array, secondary: Array) -> Array:
    """Orthonormal axes (..., 3, 3) as columns: along `primary`, along the rest of `secondary`, and their normal."""
    x = normalize(primary)
    y = normalize(secondary - np.sum(secondary * x, axis=-1, keepdims=True) * x)
    return np.stack([x, y, cross(x, y)], axis=-1)


def _rigid(now: tuple[Array, Array], rest: tuple[Array, Array]) -> Array:
    """Rotations (K, T, 3, 3) that turn rest pairs of directions (K, 3) into the present pairs (K, T, 3)."""
    return np.asarray(_frame(*now) @ _frame(*rest).swapaxes(-1, -2)[:, None])


def _turn(rotation: Array, offset: Array, direction: Array) -> Array:
    """`rotation` followed by the smallest turn that makes the bone `offset` (K, 3) point along `direction`."""
    return matrix_between(_apply(rotation, offset), direction) @ rotation


def _apply(rotation: Array, vector: Array) -> Array:
    """Vectors (K, 3) turned by rotations (K, T, 3, 3)."""
    return np.asarray((rotation @ vector[:, None, :, None])[..., 0])


def _limb(parent: Array, upper_off: Array, upper: Array, lower: Array, axis: Array, centre: Array) -> Array:
    """World rotations of the first joints of K two-bone limbs, hinge axes turned into the plane of the bend.

    Args:
        parent: (K, T, 3, 3) world rotation of the joint's parent.
        upper_off: (K, 3) rest offset of the bone; axis: (K, 3) rest axis of the hinge at its end.
        upper, lower: (K, T, 3) present directions of the two bones.
        centre: (K, 1) twist in radians about which the range (centre - pi, centre + pi) is centred.
    """
    swing = _turn(parent, upper_off, upper)
    upper, lower = normalize(upper), normalize(lower)
    default = _apply(swing, axis)
    normal = cross(upper, lower)
    twist = np.arctan2(np.sum(cross(default, normal) * upper, axis=-1), np.sum(default * normal, axis=-1))
    twist = wrap_angle(twist - centre) + centre
    low, high = BEND_SINE_RANGE
    # A folded elbow has a small sine too, but a well-defined plane as long as the bones are not parallel.
    sine = np.where(np.sum(upper * lower, axis=-1) < 0, 1.0, np.linalg.norm(normal, axis=-1))
    s = np.clip((sine - low) / (high - low), 0.0, 1.0)
    return matrix_from_axis_angle(upper, twist * s * s * (3 - 2 * s)) @ swing


def _flatten_sole(foot: Array) -> Array:
    """Roll the foot about its own length so that small tilts of the sole vanish."""
    along, left = foot[..., :, 0], foot[..., :, 1]
    level = normalize(cross(np.array([0.0, 0.0, 1.0]), along))
    roll = np.arctan2(np.sum(cross(left, level) * along, axis=-1), np.sum(left * level, axis=-1))
    horizontal = np.linalg.norm(along[..., :2], axis=-1) ** 2
    return matrix_from_axis_angle(along, roll * np.exp(-((roll / ROLL_SCALE_RAD) ** 2)) * horizontal) @ foot


def _toe(foot: Array) -> Array:
    """World rotation of the toes: kept level while the heel is up, else in line with the foot."""
    down = np.arcsin(np.clip(-foot[..., 2, 0], -1.0, 1.0))
    pitch = -np.clip(down, 0.0, MAX_TOE_EXTENSION_RAD)
    return foot @ matrix_from_axis_angle(np.broadcast_to([0.0, 1.0, 0.0], pitch.shape + (3,)), pitch)


def rotations_from_positions(positions_w_m: npt.ArrayLike, skeleton: Skeleton = CANONICAL) -> Array:
    """Rotation of each joint relative to its parent from joint positions (first-order IK of HumanML3D, with twist).

    Args:
        positions_w_m: (T, 22, 3) world positions; bone lengths need not be the skeleton's.
        skeleton: one with the 22 joint names of `CANONICAL`.

    Returns:
        (T, 22, 3, 3) local rotations, the root's in the world. Collars and neck do not twist, head and wrists follow
        their parents, toes only pitch.
    """
    p = np.asarray(positions_w_m, dtype=np.float64)
    p, off = np.ascontiguousarray(np.swapaxes(p, 0, 1)), skeleton.offsets_m
    # Joints whose rotations depend on the same ones are done together: most of the time goes into calls, not numbers.
    world = np.empty((*p.shape, 3))

    def rows(*names: str) -> list[int]:
        return [skeleton.index(name) for name in names]

    def both(*parts: str) -> list[int]:
        return rows(*(f"{side}_{part}" for part in parts for side in ("left", "right")))

    pelvis, spine1, chest, neck = rows("pelvis", "spine1", "spine3", "neck")
    hips, collars = both("hip"), both("collar")
    waist = p[spine1] - 0.5 * (p[hips[0]] + p[hips[1]])
    waist_rest = off[spine1] - 0.5 * (off[hips[0]] + off[hips[1]])
    world[[pelvis, chest]] = _rigid(
        (np.stack([p[hips[0]] - p[hips[1]], p[neck] - p[chest]]), np.stack([waist, p[collars[0]] - p[collars[1]]])),
        (np.stack([off[hips[0]] - off[hips[1]], off[neck]]), np.stack([waist_rest, off[collars[0]] - off[collars[1]]])),
    )
    bend = rotvec_from_matrix(np.swapaxes(world[pelvis], -1, -2) @ world[chest])
    bases = np.empty((5, *bend.shape, 3))
    bases[:2] = world[pelvis] @ matrix_from_rotvec(SPINE_SHARES[:, None, None] * bend)
    bases[2:] = world[chest]
    joints, ends = rows("spine1", "spine2", "neck") + collars, rows("spine2", "spine3", "head") + both("shoulder")
    world[joints] = _turn(bases, off[ends], p[ends] - p[joints])

    first, second, last = both("hip", "shoulder"), both("knee", "elbow"), both("ankle", "wrist")
    lower = p[last] - p[second]
    world[first] = _limb(
        world[[pelvis, pelvis, *collars]], off[second], p[second] - p[first], lower, LIMB_AXES, LIMB_TWIST_CENTRES_RAD
    )
    world[second] = _turn(world[first], off[last], lower)

    ankles, feet = both("ankle"), both("foot")
    along = p[feet] - p[ankles]
    sole = _flatten_sole(_turn(world[both("knee")], off[feet], along))
    # Rolling about the foot's own axis moves the toe joint, which lies below that axis: point it back.
    world[ankles] = _turn(sole, off[feet], along)
    world[feet] = _toe(world[ankles])
    world[rows("head", "left_wrist", "right_wrist")] = world[rows("neck", "left_elbow", "right_elbow")]
    return local_from_global(skeleton, np.swapaxes(world, 0, 1))


def clip_from_positions(
    positions_w_m: npt.ArrayLike, fps: float, skeleton: Skeleton = CANONICAL, rebuild: bool = False
) -> MotionClip:
    """Clip with rotations by IK.

    Args:
        positions_w_m: (T, 22, 3).
        fps: rate of the frames.
        rebuild: make the positions anew by forward kinematics, so that all bones have exactly the skeleton's lengths.
    """
    positions = np.asarray(positions_w_m, dtype=np.float64)
    local = rotations_from_positions(positions, skeleton)
    if rebuild:
        positions, _ = forward_kinematics(skeleton, positions[:, 0], local)
    return MotionClip(positions, matrix_to_6d(local), fps, skeleton.id)


def standing_pose(skeleton: Skeleton = CANONICAL, heading_rad: float = 0.0) -> Array:
    """(22, 3, 3) local rotations of relaxed standing with the arms hanging, facing `heading_rad`."""
    local = np.broadcast_to(np.eye(3), (len(skeleton), 3, 3)).copy()
    local[0] = matrix_about_z(heading_rad)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        hang = matrix_from_axis_angle(np.array([1.0, 0.0, 0.0]), np.array(-sign * np.deg2rad(80.0)))
        local[skeleton.index(f"{side}_shoulder")] = hang
        local[skeleton.index(f"{side}_elbow")] = matrix_from_axis_angle(
            np.array([0.0, 0.0, -sign]), np.array(np.deg2rad(20.0))
        )
    return local


def standing_clip(frames: int, fps: float, skeleton: Skeleton = CANONICAL, heading_rad: float = 0.0) -> MotionClip:
    """Relaxed standing at the origin for `frames` frames, soles on the floor."""
    local = np.broadcast_to(standing_pose(skeleton, heading_rad), (frames, len(skeleton), 3, 3))
    root = np.broadcast_to([0.0, 0.0, skeleton.root_height_m], (frames, 3))
    positions, _ = forward_kinematics(skeleton, root, local)
    return MotionClip(positions, matrix_to_6d(local), fps, skeleton.id)
