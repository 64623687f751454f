"""Made sits and rises on seats of any height: recorded descents warped to the seat, over feet that stay planted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from shared.data.balance import lean_over_feet, on_feet
from shared.data.make_stand import ease, idle, wander
from shared.data.make_steps import blended, flat_footed, moved, step_to, swayed
from shared.data.phases import seated_runs
from shared.data.props import PELVIS_OVER_SEAT_M, Seat
from shared.data.splice import local_rotations
from shared.motion.body import SIDES, SOLE_UNDER_ANKLE_M, Array, J, heading_rad
from shared.motion.resampling import resample
from shared.motion.rotations import matrix_about_z, normalize, wrap_angle
from shared.motion.skeleton import CANONICAL
from shared.protocol.rates import CORPUS_FPS as FPS

LOWEST_M, HIGHEST_M = 0.2, 0.6
_SEAT_M = (0.40, 0.45, 0.06)
_HIP_UNDER_PELVIS_M = 0.075
_THIGH_M = float(CANONICAL.bone_lengths_m[J["left_knee"]])
_SHANK_M = float(CANONICAL.bone_lengths_m[J["left_ankle"]])
_THIGH_ROOM_M = 0.03
"""How far a thigh's flesh may sink into the front of a seat."""


@dataclass(frozen=True)
class Descent:
    """A recorded way from a stand onto a seat, or a rise told backwards, in the frame of the seat's heading.

    Attributes:
        local: (T, 22, 3, 3) local rotations, the root's relative to the heading.
        down, back: (T,) share of the way down and back that the pelvis has gone, 0 standing and 1 seated.
        drop_m: how far down it went.
    """

    local: Array
    down: Array
    back: Array
    drop_m: float


def descents(p: Array, rising: bool) -> list[Descent]:
    """What a recorded sit or rise (T, 22, 3) teaches, its feet planted all along; none where it does not."""
    if rising:
        p = p[::-1]
    out = []
    for a, _ in seated_runs(p)[:1]:
        z = gaussian_filter1d(p[:, 0, 2], 1.5, mode="nearest")
        stop = min(a + 12, len(p))
        high = np.flatnonzero(z[:a] > np.percentile(z, 95) - 0.05)
        if not len(high):
            continue
        start = max(int(high[-1]) - 4, 0)
        q = p[start:stop]
        yaw = float(np.median(heading_rad(p[a : a + 15])))
        c, s = np.cos(yaw), np.sin(yaw)
        ahead = gaussian_filter1d(q[:, 0, :2] @ np.array([c, s]), 1.5, mode="nearest")
        drop, way = float(z[start] - z[stop - 1]), float(ahead[0] - ahead[-1])
        turned = float(np.abs(wrap_angle(heading_rad(q) - yaw)).max())
        if drop < 0.12 or way < 0.08 or turned > 0.7 or len(q) < 15 or len(q) > 90:
            continue
        local = local_rotations(q)
        local[:, 0] = matrix_about_z(np.array(-yaw)) @ local[:, 0]
        down = np.clip((z[start] - z[start:stop]) / drop, 0.0, 1.03)
        back = np.clip((ahead[0] - ahead) / way, -0.35, 1.1)
        out.append(Descent(local, down, back, drop))
    return out


def _seated_back_m(pelvis_m: float, shank_rad: float) -> float:
    """How far behind the ankles a pelvis at a height is, shanks inclined forward by an angle, thighs to the hips."""
    knee = SOLE_UNDER_ANKLE_M + _SHANK_M * float(np.cos(shank_rad))
    rise = knee - (pelvis_m - _HIP_UNDER_PELVIS_M)
    return float(np.sqrt(max(_THIGH_M**2 - rise**2, 0.04))) - _SHANK_M * float(np.sin(shank_rad))


def seat_for(pose: Array, height_m: float, back_m: float) -> Seat:
    """The seat on which a body that stands in `pose` will sit, its pelvis `back_m` behind the ankles.

    Where the knees are lower than the hips the body perches nearer the front, so that the thighs clear the edge.
    """
    yaw = float(heading_rad(pose[None])[0])
    ahead = np.array([np.cos(yaw), np.sin(yaw)])
    middle = 0.5 * (pose[J["left_ankle"], :2] + pose[J["right_ankle"], :2])
    hip = height_m + PELVIS_OVER_SEAT_M - _HIP_UNDER_PELVIS_M
    knee = SOLE_UNDER_ANKLE_M + 0.99 * _SHANK_M
    slope = (hip - knee) / max(back_m, 0.2)
    edge = _THIGH_ROOM_M / slope if slope > 0 else np.inf
    edge = float(np.clip(edge, 0.07, _SEAT_M[0] / 2))
    at = middle - (back_m + _SEAT_M[0] / 2 - edge) * ahead
    return Seat((float(at[0]), float(at[1]), height_m), yaw, _SEAT_M)


def sit_down(
    pose: Array, height_m: float, how: Descent, rng: np.random.Generator, rest_s: float, seated_s: float
) -> tuple[Array, Seat]:
    """From the stand `pose` (22, 3) onto a seat behind it, and sitting still.

    Args:
        height_m: of the seat's top. how: the recorded way down. rest_s, seated_s: seconds of standing and sitting.

    Returns:
        (T, 22, 3) and the seat.
    """
    pose = flat_footed(pose)
    yaw = float(heading_rad(pose[None])[0])
    low = height_m + PELVIS_OVER_SEAT_M
    # On a high seat the feet are tucked under, or the trunk would have to lean far forward on the way.
    tuck = rng.uniform(3.0, 13.0) + 13.0 * np.clip((height_m - 0.35) / 0.25, 0.0, 1.0)
    back_m = _seated_back_m(low, float(np.radians(tuck)))
    drop = pose[0, 2] - low
    rate = float(np.clip(np.sqrt(how.drop_m / drop), 0.75, 1.3)) * rng.uniform(0.85, 1.1)
    keys = np.concatenate([how.down[:, None], how.back[:, None]], axis=-1)
    keys = resample(keys, FPS * rate, FPS)
    n = len(keys)
    source = np.clip(np.linspace(0, len(how.local) - 1, n), 0, len(how.local) - 1)
    k = np.minimum(source.astype(int), len(how.local) - 2)
    recorded = np.stack(
        [blended(how.local[i], how.local[i + 1], np.array([f]))[0] for i, f in zip(k, source - k, strict=True)]
    )
    lead, tail = int(rest_s * FPS), int(seated_s * FPS)
    frames = lead + n + tail
    index = np.clip(np.arange(frames) - lead, 0, n - 1)
    down = gaussian_filter1d(keys[index, 0], 1.0, mode="nearest")
    back = gaussian_filter1d(keys[index, 1], 1.0, mode="nearest")
    still = idle(pose, frames, rng, 0.7)
    start = local_rotations(still)
    start[:, 0] = matrix_about_z(np.array(-yaw)) @ start[:, 0]
    w = ease((np.arange(frames) - lead + 6) / min(24.0, 0.6 * n))
    local = swayed(blended(start, recorded[index], w), rng)
    local[:, 0] = matrix_about_z(np.array(yaw)) @ local[:, 0]
    ahead = np.array([np.cos(yaw), np.sin(yaw)])
    middle = 0.5 * (pose[J["left_ankle"], :2] + pose[J["right_ankle"], :2])
    own_back = -float((pose[0, :2] - middle) @ ahead)
    root = still[:, 0].copy()
    # Sway belongs to the stand; whoever sits is still.
    root[:, :2] = pose[0, :2] + (1 - np.clip(down, 0, 1))[:, None] * (root[:, :2] - pose[0, :2])
    root[:, :2] -= (back * (back_m - own_back))[:, None] * ahead
    across = np.array([-ahead[1], ahead[0]])
    root[:, :2] -= np.clip(down, 0, 1)[:, None] * ((pose[0, :2] - middle) @ across) * across
    root[:, 2] = still[:, 0, 2] * (1 - np.clip(down, 0, 1)) + np.clip(down, 0, 1) * pose[0, 2] - down * drop
    ankles = {side: np.repeat(pose[None, J[f"{side}_ankle"]], frames, axis=0) for side in SIDES}
    feet = {
        side: np.repeat((pose[J[f"{side}_foot"]] - pose[J[f"{side}_ankle"]])[None], frames, axis=0) for side in SIDES
    }
    free = gaussian_filter1d((down < 0.85).astype(np.float64), 5.0, mode="nearest")
    local = lean_over_feet(local, root, ankles, feet, free)
    seat = seat_for(pose, height_m, back_m)
    return on_feet(local, root, ankles, feet), seat


def stay_seated(p: Array, frames: int, rng: np.random.Generator) -> Array:
    """(frames, 22, 3) sitting on in the last pose of p: trunk, head and arms live, pelvis and feet do not move."""
    pose = p[-1]
    local = np.repeat(local_rotations(pose[None]), frames, axis=0)
    fade = ease(np.arange(frames) / FPS)[:, None, None, None]
    local = local + fade * (swayed(local, rng, 1.6) - local)
    u, _, vt = np.linalg.svd(local)
    local = u @ vt
    root = np.repeat(pose[None, 0], frames, axis=0) + 0.002 * fade[:, 0, 0] * wander(rng, frames, 3)
    ankles = {side: np.repeat(pose[None, J[f"{side}_ankle"]], frames, axis=0) for side in SIDES}
    feet = {
        side: np.repeat((pose[J[f"{side}_foot"]] - pose[J[f"{side}_ankle"]])[None], frames, axis=0) for side in SIDES
    }
    return on_feet(local, root, ankles, feet)


def stand_up(
    pose: Array, height_m: float, how: Descent, rng: np.random.Generator, seated_s: float, rest_s: float
) -> tuple[Array, Seat]:
    """From a seat up into the stand `pose`: a way down told backwards."""
    p, seat = sit_down(pose, height_m, how, rng, rest_s, seated_s)
    return p[::-1], seat


def back_up_and_sit(
    pose: Array, height_m: float, how: Descent, rng: np.random.Generator, back_m: float, seated_s: float
) -> tuple[Array, Seat]:
    """A step or two back to the seat, then down onto it."""
    there = flat_footed(moved(pose, -back_m, float(rng.normal(0.0, 0.03))))
    first = step_to(flat_footed(pose), there, rng, (rng.uniform(0.3, 0.9), 0.25))
    second, seat = sit_down(there, height_m, how, rng, 0.15, seated_s)
    return joined(first, second), seat


def joined(a: Array, b: Array, frames: int = 8) -> Array:
    """`a`, then `b` that begins about where `a` ends: what differs at the joint decays over `frames` frames."""
    w = 1 - ease((np.arange(min(frames, len(b))) + 1) / frames)
    local_a, local_b = local_rotations(a[-1:])[0], local_rotations(b[: len(w)])
    mixed = blended(local_b, np.broadcast_to(local_a, local_b.shape), w)
    root = b[: len(w), 0] + w[:, None] * (a[-1, 0] - b[0, 0])
    ankles = {s: b[: len(w), J[f"{s}_ankle"]] + w[:, None] * (a[-1] - b[0])[J[f"{s}_ankle"]] for s in SIDES}
    feet = {}
    for s in SIDES:
        ankle, foot = J[f"{s}_ankle"], J[f"{s}_foot"]
        toe = (
            b[: len(w), foot]
            - b[: len(w), ankle]
            + w[:, None] * ((a[-1, foot] - a[-1, ankle]) - (b[0, foot] - b[0, ankle]))
        )
        feet[s] = CANONICAL.bone_lengths_m[foot] * normalize(toe)
    return np.concatenate([a, on_feet(mixed, root, ankles, feet, lower=False), b[len(w) :]])


def pick_descent(rng: np.random.Generator, ways: Sequence[Descent], height_m: float) -> Descent:
    """One of several, those rather whose own seat was about as high."""
    drops = np.array([w.drop_m for w in ways])
    want = CANONICAL.root_height_m - height_m - PELVIS_OVER_SEAT_M
    p = np.exp(-np.abs(drops - want) / 0.12)
    return ways[int(rng.choice(len(ways), p=p / p.sum()))]
