"""Made motion from walks and runs: bent paths, and takes joined at like poses into starts, stops and turns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from shared.data.label import path_speed
from shared.data.splice import extend_cycle, join, nearest, settle
from shared.motion.body import Array, heading_rad, place, runs
from shared.protocol.rates import CORPUS_FPS as FPS

JOIN_DISTANCE = 0.30
"""Distance of poses (splice.pose_features, metres) below which two takes may be joined."""


@dataclass(frozen=True)
class Source:
    """A piece to make motion from, and the take that decides its split."""

    take: str
    source: str
    positions: Array


def bend_path(p: Array, yaw_rate_rad_s: Array | float) -> Array:
    """The motion with a yaw rate added, scalar or (T,): whole poses turn, steps turn with them.

    The rate is scaled down where the body moves slower than 0.8 m/s, so that a stand is not spun.
    """
    rate = np.broadcast_to(np.asarray(yaw_rate_rad_s, dtype=np.float64), (len(p),))
    rate = rate * np.clip(path_speed(p) / 0.8, 0.0, 1.0)
    yaw = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1])) / FPS])
    step = np.diff(p[:, 0, :2], axis=0)
    middle = 0.5 * (yaw[1:] + yaw[:-1])
    c, s = np.cos(middle), np.sin(middle)
    turned = np.stack([c * step[:, 0] - s * step[:, 1], s * step[:, 0] + c * step[:, 1]], axis=-1)
    root = np.concatenate([p[:1, 0, :2], p[0, 0, :2] + np.cumsum(turned, axis=0)])
    return place(p, yaw, root - p[:, 0, :2], p[:, 0, :2])


def yaw_pulse(frames: int, angle_rad: float, seconds: float, start: int) -> Array:
    """(frames,) yaw rate that turns by `angle_rad` within about `seconds`, beginning at frame `start`."""
    rate = np.zeros(frames)
    n = max(int(seconds * FPS), 1)
    rate[start : start + n] = angle_rad / seconds
    return np.asarray(gaussian_filter1d(rate, 4.0, mode="nearest"))


def long_walk(p: Array, frames: int) -> Array | None:
    """At least `frames` frames of a walk or run, repeating its best cycle, cut to length; None where it has none."""
    longer = extend_cycle(p, frames)
    return None if longer is None else longer[:frames]


def find_starts(p: Array, slow: float = 0.2, fast: float = 0.8) -> list[tuple[int, int]]:
    """(first frame of the stand, first frame at speed) of each start from a stand to walking within 1.5 s."""
    speed = path_speed(p)
    out = []
    for a, b in runs(speed < slow):
        quick = np.flatnonzero(speed[b : b + 45] > fast)
        if b - a < 8 or not len(quick):
            continue
        turn = float(np.ptp(np.unwrap(heading_rad(p[max(a, b - 25) : b + int(quick[0])]))))
        if turn < np.radians(50):  # slowing down within a turn is no stand
            out.append((max(a, b - 25), b + int(quick[0])))
    return out


def find_stops(p: Array, slow: float = 0.2, fast: float = 0.8) -> list[tuple[int, int]]:
    """(last frame at speed, last frame of the stand) of each stop."""
    n = len(p)
    return [(n - 1 - b, n - 1 - a) for a, b in find_starts(p[::-1], slow, fast)]


def find_turns(p: Array, angle_rad: float = np.radians(75), seconds: float = 1.5) -> list[tuple[int, int]]:
    """Frame ranges of sharp turns: heading changes by `angle_rad` or more within `seconds`, while walking about."""
    n = int(seconds * FPS)
    if len(p) <= n:
        return []
    yaw = gaussian_filter1d(heading_rad(p), 4.0, mode="nearest")
    sharp = np.abs(yaw[n:] - yaw[:-n]) > angle_rad
    return [(a, b + n) for a, b in runs(sharp)]


def after(a: Array, b: Array, a_range: tuple[int, int], b_range: tuple[int, int]) -> tuple[Array, int] | None:
    """`a`, then `b`, joined where their poses are closest within the ranges; and the frame of the joint.

    None where no two poses are close enough.
    """
    a_range = (max(a_range[0], 4), min(a_range[1], len(a) - 5))
    b_range = (max(b_range[0], 4), min(b_range[1], len(b) - 5))
    if a_range[1] <= a_range[0] or b_range[1] <= b_range[0]:
        return None
    i, j, distance = nearest(a, b, a_range, b_range)
    return (join(a, i, b, j), i) if distance < JOIN_DISTANCE else None


def start_walking(start: Array, at: tuple[int, int], walk: Array, frames: int) -> Array | None:
    """A recorded start from a stand (its frames `at`) that goes on as another walk."""
    joined = after(start[at[0] :], walk, (at[1] - at[0], at[1] - at[0] + 40), (0, len(walk) - 30))
    if joined is None:
        return None
    out = joined[0]
    return out[:frames] if len(out) >= frames else out


def stop_walking(
    walk: Array, stop: Array, at: tuple[int, int], stand_frames: int, earliest: int = 25
) -> Array | None:  # fmt: skip
    """A walk of at least `earliest` frames that ends in another take's recorded stop (its frames `at`) and a stand."""
    joined = after(walk, stop[: at[1] + 1], (earliest, len(walk)), (max(at[0] - 40, 0), at[0] + 4))
    return None if joined is None else settle(joined[0], stand_frames)


def turn_within_walk(before: Array, turning: Array, at: tuple[int, int], follow: Array) -> Array | None:
    """A walk, another take's recorded sharp turn (its frames `at`), and a walk again."""
    first = after(before, turning, (20, 80), (max(at[0] - 30, 0), at[0] + 6))
    if first is None:
        return None
    joined, i = first
    span = at[1] - max(at[0] - 30, 0)
    second = after(joined, follow, (i + span - 6, i + span + 40), (0, max(len(follow) - 40, 10)))
    return None if second is None else second[0]


def pick(rng: np.random.Generator, items: Sequence[Source]) -> Source:
    """One of several, evenly."""
    return items[int(rng.integers(len(items)))]
