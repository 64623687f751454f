"""Joining pieces of motion: nearest poses, cross-fades, cycles, and settling into a quiet stand."""

from __future__ import annotations

import numpy as np
from scipy.signal import savgol_filter

from shared.motion.body import SIDES, SOLE_UNDER_ANKLE_M, Array, J, forward_of, heading_rad, place
from shared.motion.heading import heading_of
from shared.motion.ik import clip_from_positions, rotations_from_positions, standing_pose
from shared.motion.kinematics import forward_kinematics
from shared.motion.limbs import solve_leg
from shared.motion.rotations import matrix_about_z
from shared.motion.skeleton import CANONICAL
from shared.protocol.rates import CORPUS_FPS as FPS

_SETTLE_RATE = 7.0
_KEY_JOINTS = ("left_knee", "left_ankle", "left_foot", "right_knee", "right_ankle", "right_foot", "pelvis", "head",
               "left_wrist", "right_wrist")  # fmt: skip


def rebuild(p: Array) -> Array:
    """Poses with exact bone lengths, by IK and forward kinematics."""
    return clip_from_positions(p, FPS, rebuild=True).positions_w_m


def denoise(p: Array) -> Array:
    """Poses without frame-to-frame noise: a cubic fitted to seven frames around each (Savitzky-Golay), bones exact.

    Recordings decimated to 30 fps keep the marker noise of their own rate: the third derivative falls by 2.5 times,
    to that of filtered ones, and joints move by a few millimetres (up to 2 cm at the fastest).
    """
    return p if len(p) < 7 else rebuild(savgol_filter(p, 7, 3, axis=0, mode="interp"))


def pose_features(p: Array) -> Array:
    """(T, F) pose and velocity relative to the body's heading and place, for distances between poses in metres."""
    keys = np.array([J[name] for name in _KEY_JOINTS])
    yaw = heading_rad(p)
    local = p[:, keys] - p[:, :1] * np.array([1.0, 1.0, 0.0])
    speed = np.gradient(p[:, keys], axis=0) * FPS if len(p) > 1 else np.zeros_like(local)
    weight = np.where(np.isin(_KEY_JOINTS, ("left_wrist", "right_wrist")), 0.5, 1.0)[:, None]

    def turned(x: Array) -> Array:
        c, s = np.cos(-yaw)[:, None], np.sin(-yaw)[:, None]
        return np.stack([c * x[..., 0] - s * x[..., 1], s * x[..., 0] + c * x[..., 1], x[..., 2]], axis=-1)

    parts = [turned(local) * weight, turned(speed) * 0.12 * weight]
    flat = [x.reshape(len(p), -1) for x in parts]
    return np.asarray(np.concatenate(flat, axis=1) / np.sqrt(len(_KEY_JOINTS)))


def align(p: Array, frame: int, to: Array) -> Array:
    """`p` turned and shifted so that its frame `frame` has the heading and floor position of the pose `to` (22, 3)."""
    turn = float(heading_rad(to[None])[0] - heading_rad(p[frame : frame + 1])[0])
    out = place(p, turn)
    shift = to[0, :2] - out[frame, 0, :2]
    return np.asarray(out + np.array([shift[0], shift[1], 0.0]))


def crossfade(a: Array, b: Array, frames: int) -> Array:
    """The last `frames` frames of `a` blended into the first `frames` of `b`; b is placed to meet a half-way."""
    half = frames // 2
    b = align(b, half, a[len(a) - frames + half])
    x = (np.arange(frames) + 1) / (frames + 1)
    w = (x * x * (3 - 2 * x))[:, None, None]
    mixed = rebuild((1 - w) * a[len(a) - frames :] + w * b[:frames])
    return np.concatenate([a[: len(a) - frames], mixed, b[frames:]])


def nearest(a: Array, b: Array, a_range: tuple[int, int], b_range: tuple[int, int]) -> tuple[int, int, float]:
    """Frames (i in a_range, j in b_range) whose poses are closest, and their distance."""
    fa, fb = pose_features(a)[a_range[0] : a_range[1]], pose_features(b)[b_range[0] : b_range[1]]
    d = np.sqrt(np.maximum((fa**2).sum(1)[:, None] + (fb**2).sum(1)[None] - 2 * fa @ fb.T, 0.0))
    i, j = np.unravel_index(int(np.argmin(d)), d.shape)
    return int(i) + a_range[0], int(j) + b_range[0], float(d[i, j])


def join(a: Array, i: int, b: Array, j: int, frames: int = 8) -> Array:
    """`a` up to about frame i, then `b` from about frame j, cross-faded over `frames` frames centred there."""
    half = frames // 2
    stop, start = min(len(a), i + frames - half), max(0, j - half)
    return crossfade(a[:stop], b[start:], min(frames, stop, len(b) - start))


def extend_cycle(p: Array, length: int, max_distance: float = 0.22, edge: int = 4) -> Array | None:
    """A cyclic motion (walk, run) made at least `length` frames long by repeating its best closing cycle, or None.

    The cycle keeps `edge` frames away from both ends, which is half of what its ends are cross-faded over.
    """
    if len(p) >= length:
        return p
    f = pose_features(p)
    n = len(p)
    d = np.sqrt(np.maximum((f**2).sum(1)[:, None] + (f**2).sum(1)[None] - 2 * f @ f.T, 0.0))
    i, j = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    # Longer cycles keep more of the recording: a small bonus per frame.
    moved = np.linalg.norm(p[None, :, 0, :2] - p[:, None, 0, :2], axis=-1)
    # A cycle must get somewhere, or pauses would be repeated.
    d = np.where(moved > 0.4 * (j - i) / FPS, d, np.inf)
    d = np.where((j - i >= 14) & (i >= edge) & (j < n - edge), d - 0.001 * (j - i), np.inf)
    best = np.unravel_index(int(np.argmin(d)), d.shape)
    if d[best] > max_distance:
        return None
    start, stop = int(best[0]), int(best[1])
    out = p[: stop + edge]
    while len(out) < length:
        out = join(out, len(out) - edge, p[: stop + edge], start, 2 * edge)
    return np.concatenate([out, crossfade(out, p[start - edge :], 2 * edge)[len(out) :]]) if n - stop > 12 else out


def stand_over_feet(pose: Array) -> Array:
    """(22, 3) a relaxed upright stand with the feet flat where the pose has them, facing where the pelvis does."""
    feet = {side: pose[J[f"{side}_ankle"], :2] for side in SIDES}
    gap = feet["left"] - feet["right"]
    f = forward_of(pose[None])[0, :2]
    heading = float(heading_of(f))
    left = np.array([-f[1], f[0]])
    # Feet that cross, nearly touch or stand far apart are brought to a stance that can be held.
    across, along = float(np.clip(gap @ left, 0.14, 0.42)), float(np.clip(gap @ f, -0.35, 0.35))
    middle = 0.5 * (feet["left"] + feet["right"])
    local = standing_pose(heading_rad=heading)
    height = CANONICAL.root_height_m - 0.012
    spread = 0.5 * np.hypot(max(across - 0.175, 0.0), along)
    leg = CANONICAL.root_height_m - SOLE_UNDER_ANKLE_M - 0.065
    height -= leg - np.sqrt(leg**2 - spread**2)
    root = np.array([middle[0] + 0.015 * f[0], middle[1] + 0.015 * f[1], height])
    p, _ = forward_kinematics(CANONICAL, root[None], local[None])
    for side, sign in (("left", 0.5), ("right", -0.5)):
        at = middle + sign * (across * left + along * f)
        # Each foot keeps its own heading within what a standing hip allows.
        d = pose[J[f"{side}_foot"], :2] - pose[J[f"{side}_ankle"], :2]
        out = np.arctan2(f[0] * d[1] - f[1] * d[0], f @ d)
        limits = (-0.15, 0.5) if side == "left" else (-0.5, 0.15)
        yaw = heading + float(np.clip(out, *limits))
        toe = matrix_about_z(yaw) @ CANONICAL.offsets_m[J[f"{side}_foot"]]
        p[0, J[f"{side}_foot"]] = p[0, J[f"{side}_ankle"]] + toe
        p = solve_leg(p, side, np.array([[at[0], at[1], SOLE_UNDER_ANKLE_M]]))
    return np.asarray(p[0])


def settle(p: Array, frames: int, target: Array | None = None) -> Array:
    """`p` followed by `frames` frames in which it comes to rest in `target` (22, 3), by default a stand over its feet.

    What differs from the target at the end of `p`, in place and velocity, decays as a critically damped spring.
    """
    if frames <= 0:
        return p
    target = stand_over_feet(p[-1]) if target is None else target
    t = ((np.arange(frames) + 1) / FPS)[:, None, None]
    x0 = (p[-1] - target)[None]
    v0 = (p[-1] - p[-2])[None] * FPS if len(p) > 1 else np.zeros_like(x0)
    offset = (x0 + (v0 + _SETTLE_RATE * x0) * t) * np.exp(-_SETTLE_RATE * t)
    # Joints move on chords; the rebuilt pose puts the bones back to length.
    return np.concatenate([p, rebuild(target[None] + offset)])


def settle_before(p: Array, frames: int, target: Array | None = None) -> Array:
    """`p` preceded by `frames` frames that start at rest: `settle` run backwards in time."""
    return settle(p[::-1], frames, target)[::-1]


def local_rotations(p: Array) -> Array:
    """(T, 22, 3, 3) local rotations of poses."""
    return rotations_from_positions(p)
