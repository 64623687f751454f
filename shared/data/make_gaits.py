"""Changes of gait that a body can perform: walk and run blended in phase over seconds, and the lean that they take.

Whoever speeds up by a or bends a path by the acceleration a leans by atan(a / g), or falls. Joining a walk to a run at
their nearest poses changes the speed within a quarter of a second, which no tracker can follow: of ten such
starts ours followed none, of ten stops two, while it followed the same runs on their own (docs/experiments_tracker.md).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import gaussian_filter1d
from scipy.signal import find_peaks

from shared.data.make_paths import bend_path
from shared.data.splice import rebuild
from shared.motion.body import SIDES, Array, J, forward_of, heading_rad, place, velocity
from shared.motion.limbs import solve_leg
from shared.motion.resampling import resample
from shared.motion.rotations import matrix_from_rotvec
from shared.protocol.rates import CORPUS_FPS as FPS

GRAVITY_MPS2 = 9.81
_LEAST_STRIDE_M = 0.12
_HALF_CYCLE_FRAMES = 5
_STRIDE_FRAMES = 12
_HEADING_FRAMES = 10.0
"""Smoothing of the heading, in frames: a stride's own swing of the hips stays in the pose."""


def lean_into(p: Array, acceleration_mps2: Array) -> Array:
    """The body inclined as an acceleration asks, over feet that stay where they are.

    Args:
        p: (T, 22, 3) upright motion.
        acceleration_mps2: (T, 2) horizontal acceleration that the motion has and did not have when it was recorded.
    """
    size = np.linalg.norm(acceleration_mps2, axis=-1, keepdims=True)
    toward = acceleration_mps2 / np.maximum(size, 1e-9)
    axis = np.stack([-toward[:, 1], toward[:, 0], np.zeros(len(p))], axis=-1)
    turn = matrix_from_rotvec(axis * np.arctan(size / GRAVITY_MPS2))
    pivot = p[:, :1] * np.array([1.0, 1.0, 0.0])
    out = np.asarray(np.einsum("tij,tkj->tki", turn, p - pivot) + pivot)
    for side in SIDES:
        ankle, foot = J[f"{side}_ankle"], J[f"{side}_foot"]
        out[:, foot] = out[:, ankle] + (p[:, foot] - p[:, ankle])
        out = solve_leg(out, side, p[:, ankle])
    return out


def curve(p: Array, yaw_rate_rad_s: Array | float) -> Array:
    """`bend_path`, and the body leans into the curve by what it adds to the sideways acceleration."""
    bent = bend_path(p, yaw_rate_rad_s)
    rate = FPS * np.gradient(heading_rad(bent) - heading_rad(p))
    v = velocity(gaussian_filter1d(bent[:, 0, :2], 6.0, axis=0, mode="nearest"), FPS)
    sideways = rate[:, None] * np.stack([-v[:, 1], v[:, 0]], axis=-1)
    return lean_into(bent, gaussian_filter1d(sideways, 3.0, axis=0, mode="nearest"))


def straightened(p: Array) -> Array:
    """A motion along a curve made to go straight, its lean into the curve undone."""
    smooth = gaussian_filter1d(heading_rad(p), 15.0, mode="nearest")
    return curve(p, -velocity(smooth, FPS))


def hastened(p: Array, factor: float) -> Array:
    """The same motion in 1 / `factor` of its time."""
    return rebuild(resample(p, FPS * factor, FPS))


@dataclass(frozen=True)
class Gait:
    """A walk or run by its phase: 0 where the left foot is farthest ahead, 0.5 where the right one is.

    Attributes:
        pose: (T, 22, 3) poses turned to the smoothed heading, over the origin (heights kept).
        step: (T, 2) metres a frame, forward and to the left. yaw_step: (T,) radians a frame.
        frame_of, phase_of: between frames and phases in cycles, increasing, inside `first`..`last` (phases).
    """

    pose: Array
    step: Array
    yaw_step: Array
    frame_of: PchipInterpolator
    phase_of: PchipInterpolator
    first: float
    last: float

    def at(self, frame: float) -> tuple[Array, Array, float]:
        """Pose, step and yaw step at a frame between two."""
        f = float(np.clip(frame, 0.0, len(self.pose) - 1.0))
        i = min(int(f), len(self.pose) - 2)
        x = f - i
        mix = [(1 - x) * values[i] + x * values[i + 1] for values in (self.pose, self.step, self.yaw_step)]
        return mix[0], mix[1], float(mix[2])


def gait(p: Array) -> Gait | None:
    """The phases of a motion (T, 22, 3); None where fewer than three steps are to be seen."""
    forward = forward_of(p)[:, :2]
    ahead = np.sum((p[:, J["left_ankle"], :2] - p[:, J["right_ankle"], :2]) * forward, axis=-1)
    ahead = gaussian_filter1d(ahead, 1.0, mode="nearest")
    marks: list[tuple[int, int]] = []  # (frame, +1 left ahead or -1 right ahead), alternating
    for sign in (1, -1):
        peaks, _ = find_peaks(sign * ahead, height=_LEAST_STRIDE_M, distance=2 * _HALF_CYCLE_FRAMES)
        marks += [(int(k), sign) for k in peaks]
    kept: list[tuple[int, int]] = []
    for mark in sorted(marks):
        if kept and kept[-1][1] == mark[1]:
            if mark[1] * ahead[mark[0]] > mark[1] * ahead[kept[-1][0]]:
                kept[-1] = mark
        elif not kept or mark[0] - kept[-1][0] >= _HALF_CYCLE_FRAMES:
            kept.append(mark)
    if len(kept) < 3:
        return None
    frames = np.array([k for k, _ in kept], dtype=np.float64)
    phases = 0.5 * np.arange(len(kept)) + (0.0 if kept[0][1] > 0 else 0.5)
    yaw = gaussian_filter1d(heading_rad(p), _HEADING_FRAMES, mode="nearest")
    root = p[:, 0, :2]
    pose = place(p, -yaw, -root, root)
    v = velocity(root, 1.0)
    c, s = np.cos(yaw), np.sin(yaw)
    step = np.stack([c * v[:, 0] + s * v[:, 1], -s * v[:, 0] + c * v[:, 1]], axis=-1)
    return Gait(
        pose, step, velocity(yaw, 1.0), PchipInterpolator(phases, frames), PchipInterpolator(frames, phases),
        float(phases[0]), float(phases[-1]),
    )  # fmt: skip


def change_gait(a: Array, at: int, b: Array, seconds: float) -> Array | None:
    """`a` up to frame `at`, then over `seconds` into the gait of `b`, and `b` to its end.

    Poses, stride and cadence go over together, step on step; the body leans into the change of speed.

    Returns:
        (T, 22, 3), its bones not quite of length until it is grounded and rebuilt; None where either motion has no
        steps long enough for it.
    """
    one, two = gait(a), gait(b)
    if one is None or two is None or not one.frame_of(one.first) <= at < one.frame_of(one.last):
        return None
    phase = float(one.phase_of(at))
    offset = np.ceil(two.first - phase + 1e-6)  # whole cycles
    frames = max(round(seconds * FPS), 2)
    yaw = float(gaussian_filter1d(heading_rad(a), _HEADING_FRAMES, mode="nearest")[at])
    place_xy = a[at, 0, :2].copy()
    x = (np.arange(frames) + 1) / frames
    share = x * x * (3 - 2 * x)
    poses, yaws, places, weights = [], [], [], []
    k, other = 0, 0.0
    while True:
        w = float(share[min(k, frames - 1)])
        if k < frames:
            if phase >= one.last - 1e-3 or phase + offset >= two.last - 1e-3:
                return None
            mine, other = float(one.frame_of(phase)), float(two.frame_of(phase + offset))
            rate_a, rate_b = (max(float(g.phase_of(f, 1)), 1e-3) for g, f in ((one, mine), (two, other)))
            d = (1 - w) * rate_a + w * rate_b
            (pose_a, step_a, yaw_a), (pose_b, step_b, yaw_b) = one.at(mine), two.at(other)
            # Metres and radians a cycle are mixed, so that planted feet stay planted.
            move = (1 - w) * step_a * d / rate_a + w * step_b * d / rate_b
            turn = (1 - w) * yaw_a * d / rate_a + w * yaw_b * d / rate_b
            pose = (1 - w) * pose_a + w * pose_b
            phase += d
        else:
            other += 1.0
            if other > len(b) - 1:
                break
            pose, move, turn = two.at(other)
        yaw += turn
        c, s = np.cos(yaw), np.sin(yaw)
        place_xy = place_xy + np.array([c * move[0] - s * move[1], s * move[0] + c * move[1]])
        poses.append(pose)
        yaws.append(yaw)
        places.append(place_xy)
        weights.append(w)
        k += 1
    if k <= frames:
        return None
    out = place(np.stack(poses), np.array(yaws), np.stack(places))
    after = int(other) - len(weights) + frames  # the frame of b that the ramp ends at
    before_mps, after_mps = (
        FPS * float(np.linalg.norm(g.step[max(k - _STRIDE_FRAMES, 0) : k + _STRIDE_FRAMES].mean(axis=0)))
        for g, k in ((one, at), (two, after))
    )
    change = (after_mps - before_mps) * FPS * np.gradient(np.array(weights))
    lean = gaussian_filter1d(change, 3.0, mode="constant")
    direction = np.stack([np.cos(yaws), np.sin(yaws)], axis=-1)
    return np.concatenate([a[: at + 1], lean_into(out, lean[:, None] * direction)])
