"""Made strikes at given points: recorded punches and kicks warped so that the limb hits, stepped into from a stand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.signal import find_peaks

from shared.data.balance import leaned, on_feet
from shared.data.label import Label, rotation_steps_rad
from shared.data.make_paths import Source
from shared.data.make_seats import joined
from shared.data.make_stand import ease
from shared.data.make_steps import flat_footed, moved, step_to
from shared.data.maker import Maker
from shared.data.pieces import Piece
from shared.data.props import Strike
from shared.data.splice import local_rotations, rebuild, stand_over_feet
from shared.motion.body import SIDES, Array, J, heading_rad, mirror, sole_height, velocity
from shared.motion.heading import heading_of
from shared.motion.limbs import elbow_pole, reach, solve_arm, solve_leg
from shared.motion.rotations import matrix_about_z, wrap_angle
from shared.motion.skeleton import CANONICAL
from shared.protocol.rates import CORPUS_FPS as FPS

HIT_M = 0.02
"""A made strike whose limb misses its point by more is left out."""

_FIST_MPS, _FOOT_M = 3.5, 0.7
_LOWEST_M, _HIGHEST_M = 0.6, 1.6
_BEHIND_RAD = 1.75
_MOST_TURN_RAD = 1.0
"""Change of a joint's rotation in a tick; recorded blows stay below it, servos cannot follow more."""
_LEVEL_M = 0.33
"""How far below and above the shoulder a fist hits without the body going down."""


@dataclass(frozen=True)
class Blow:
    """One recorded punch or kick, from a moment of calm on both feet to the next.

    Attributes:
        source: of `positions` (T, 22, 3). joint: what hits. contact: the frame in which it would, just before the
            limb is stretched farthest at frame `farthest`.
    """

    source: Source
    positions: Array
    joint: str
    contact: int
    farthest: int


def blows(pieces: Sequence[Piece]) -> list[Blow]:
    """The punches and kicks in recorded pieces and in their mirror images."""
    out = []
    for piece in pieces:
        if piece.label.behaviour not in ("punch", "kick") and piece.label.action != "karate":
            continue
        if piece.label.action in ("kick_ball", "kick_spin"):
            continue
        for p in (piece.positions, mirror(piece.positions)):
            source = Source(piece.take, piece.source, p)
            for side in SIDES:
                out += _punches(source, side) + _kicks(source, side)
    return out


def _calm(p: Array) -> Array:
    """(T,) how far a frame is from standing quietly on both feet."""
    speed = np.linalg.norm(velocity(p, FPS), axis=-1).mean(axis=-1)
    return np.asarray(speed + 40.0 * np.clip(sole_height(p).max(axis=-1) - 0.02, 0.0, None))


def _cut(source: Source, joint: str, contact: int, farthest: int) -> list[Blow]:
    p = source.positions
    calm = _calm(p)
    a, b = max(contact - 50, 0), min(farthest + 50, len(p))
    if contact - a < 10 or b - farthest < 10:
        return []
    start = a + int(np.argmin(calm[a : contact - 8]))
    stop = farthest + 8 + int(np.argmin(calm[farthest + 8 : b]))
    if max(calm[start], calm[stop]) > 1.6:
        return []
    return [Blow(source, p[start : stop + 1], joint, contact - start, farthest - start)]


def _punches(source: Source, side: str) -> list[Blow]:
    p = source.positions
    wrist, shoulder = p[:, J[f"{side}_wrist"]], p[:, J[f"{side}_shoulder"]]
    stretch = np.linalg.norm(wrist - shoulder, axis=-1)
    speed = np.linalg.norm(velocity(wrist, FPS), axis=-1)
    out = []
    for k in find_peaks(stretch, height=0.5, distance=12, prominence=0.12)[0].tolist():
        if speed[max(k - 6, 0) : k + 1].max() < _FIST_MPS or wrist[k, 2] < 0.75:
            continue
        near = np.flatnonzero(stretch[max(k - 8, 0) : k] < 0.95 * stretch[k])
        contact = max(k - 8, 0) + int(near[-1]) + 1 if len(near) else k - 1
        out += _cut(source, f"{side}_wrist", contact, k)
    return out


def _kicks(source: Source, side: str) -> list[Blow]:
    p = source.positions
    foot, other = p[:, J[f"{side}_foot"]], sole_height(p)[:, 1 if side == "left" else 0]
    away = np.linalg.norm(foot[:, :2] - p[:, J[f"{side}_hip"], :2], axis=-1) * (foot[:, 2] > 0.45)
    out = []
    for k in find_peaks(away, height=0.55, distance=20)[0].tolist():
        if foot[max(k - 6, 0) : k + 7, 2].max() < _FOOT_M or other[k] > 0.06:
            continue
        near = np.flatnonzero(away[max(k - 8, 0) : k] < 0.93 * away[k])
        contact = max(k - 8, 0) + int(near[-1]) + 1 if len(near) else k - 1
        out += _cut(source, f"{side}_foot", contact, k)
    return out


def _bell(frames: int, start: int, contact: int, farthest: int, stop: int) -> Array:
    """(frames,) 0 outside start..stop, 1 from contact to farthest."""
    t = np.arange(frames)
    up = ease((t - start) / max(contact - start, 1))
    down = ease((stop - t) / max(stop - farthest, 1))
    return np.asarray(np.minimum(up, down))


def _planted(p: Array) -> tuple[dict[str, Array], dict[str, Array]]:
    ankles = {side: p[:, J[f"{side}_ankle"]] for side in SIDES}
    return ankles, {side: p[:, J[f"{side}_foot"]] - ankles[side] for side in SIDES}


def punch_at(blow: Blow, height_m: float, aside_rad: float, stretch: float) -> tuple[Array, Array]:
    """A recorded punch bent to a point: body lowered and inclined where the point is low, the arm led there by IK.

    Args:
        height_m: of the point. aside_rad: its direction from the shoulder against the recorded one. stretch: share of
            the arm's reach at contact; the fist goes on from there.

    Returns:
        (T, 22, 3) and the point (3,).
    """
    p, side, c, k = blow.positions, blow.joint.split("_")[0], blow.contact, blow.farthest
    n = len(p)
    shoulder, wrist = J[f"{side}_shoulder"], J[f"{side}_wrist"]
    low = float(np.clip(p[c, shoulder, 2] - _LEVEL_M - height_m, 0.0, 0.45))
    if low > 0.01:
        w = _bell(n, max(c - 20, 0), c, k, min(k + 22, n - 1))
        local = leaned(local_rotations(p), 1.1 * low * w)
        root = p[:, 0] - (0.62 * low * w)[:, None] * [0.0, 0.0, 1.0]
        p = on_feet(local, root, *_planted(p))
    arm = CANONICAL.bone_lengths_m
    length = reach(float(arm[J[f"{side}_elbow"]]), float(arm[wrist]))
    at = p[c, shoulder]
    out = matrix_about_z(np.array(aside_rad)) @ ((p[c, wrist] - at) * [1.0, 1.0, 0.0])
    rise = float(np.clip(height_m - at[2], -0.85 * stretch * length, 0.85 * stretch * length))
    flat = float(np.sqrt((stretch * length) ** 2 - rise**2))
    point = at + out / np.linalg.norm(out) * flat + np.array([0.0, 0.0, rise])
    w = _bell(n, max(c - 14, 0), c, min(k + 1, n - 1), min(k + 16, n - 1))
    path = p[:, wrist] + w[:, None] * (point - p[c, wrist])
    # An elbow that is up at the end of a jab is turned down: led elsewhere it would twist through its far side.
    q = solve_arm(p, side, path)
    turned_in = 0.85 * _bell(n, max(c - 9, 0), max(c - 1, 1), min(k + 1, n - 1), min(k + 11, n - 1))
    return solve_arm(q, side, path, elbow_pole(q, side, turned_in)), point


def kick_at(blow: Blow, height_m: float, aside_rad: float, stretch: float) -> tuple[Array, Array]:
    """A recorded kick bent to a point; as `punch_at`, the leg led there while its foot is off the floor."""
    p, side, c, k = blow.positions, blow.joint.split("_")[0], blow.contact, blow.farthest
    n = len(p)
    hip, ankle, foot = (J[f"{side}_{part}"] for part in ("hip", "ankle", "foot"))
    up = sole_height(p)[:, 0 if side == "left" else 1] > 0.04
    lift = c - int(np.argmin(up[c::-1])) if not up[: c + 1].all() else 0
    land = k + int(np.argmin(up[k:])) if not up[k:].all() else n - 1
    legs = CANONICAL.bone_lengths_m
    length = reach(float(legs[J[f"{side}_knee"]]), float(legs[ankle]))
    toe = p[c, foot] - p[c, ankle]
    at = p[c, hip]
    rise = float(np.clip(height_m - toe[2] - at[2], -0.8 * stretch * length, 0.8 * stretch * length))
    flat = float(np.sqrt((stretch * length) ** 2 - rise**2))
    out = matrix_about_z(np.array(aside_rad)) @ ((p[c, ankle] - at) * [1.0, 1.0, 0.0])
    goal = at + out / np.linalg.norm(out) * flat + np.array([0.0, 0.0, rise])
    w = gaussian_filter1d(_bell(n, lift, c - 1, min(k + 1, n - 1), max(land, k + 4)), 0.7, mode="nearest")
    path = p[:, ankle] + (w / max(w[c], 0.5))[:, None] * (goal - p[c, ankle])
    path[:, 2] = np.maximum(path[:, 2], np.minimum(p[:, ankle, 2], 0.2))
    q = solve_leg(p, side, path)
    return q, goal + toe


def _facing(pose: Array, point: Array) -> Array | None:
    """A stand about where `pose` is that looks at the point; None where that is behind it."""
    stand = stand_over_feet(pose)
    to = point[:2] - pose[0, :2]
    turn = float(wrap_angle(heading_of(to) - heading_rad(stand[None])[0]))
    return moved(stand, 0.0, 0.0, turn) if abs(turn) < _BEHIND_RAD else None


def strikes(maker: Maker, known: Sequence[Blow], count: int) -> None:
    """Punches and kicks at points over what the limbs reach, with steps into them, and the stand that follows."""
    rng = maker.rng
    kinds = {part: [b for b in known if b.joint.endswith(part)] for part in ("wrist", "foot")}
    for i in range(count):
        part = ("wrist", "foot")[i % 2]
        if not kinds[part]:
            continue
        blow = kinds[part][int(rng.integers(len(kinds[part])))]
        aside = float(rng.uniform(-0.35, 0.35))
        if part == "wrist":
            height = float(rng.uniform(_LOWEST_M, _HIGHEST_M))
            p, point = punch_at(blow, height, aside, float(rng.uniform(0.82, 0.95)))
        else:
            height = float(rng.uniform(_LOWEST_M, 1.4))
            p, point = kick_at(blow, height, aside, float(rng.uniform(0.8, 0.94)))
        side = blow.joint.split("_")[0]
        behaviour, action = ("punch", "punch_at") if part == "wrist" else ("kick", "kick_at")
        first = flat_footed(p[0])
        before, after = _facing(p[0], point), _facing(p[-1], point)
        if before is None or after is None:
            continue
        far = 0.0 if rng.random() < 0.4 else float(rng.uniform(0.1, 0.7))
        there = step_to(
            flat_footed(moved(before, -far, 0.0)), first, rng, (rng.uniform(0.3, 0.9), 0.1), rng.uniform(0.34, 0.46)
        )
        q = joined(there, rebuild(p))
        back = step_to(flat_footed(q[-1]), flat_footed(after), rng, (0.1, rng.uniform(0.5, 1.0)))
        q = joined(q, back)
        frame = len(there) + blow.contact
        miss = float(np.linalg.norm(q[frame, J[blow.joint]] - point))
        turn = float(rotation_steps_rad(local_rotations(q)).max())
        wrong = f"misses by {1000 * miss:.0f} mm" if miss > HIT_M else ""
        wrong = wrong or (f"a joint turns {turn:.2f} rad in one tick" if turn > _MOST_TURN_RAD else "")
        if wrong:
            maker.report.drop(f"made/{maker.split}/strike/{i:04d} from {blow.source.take}", wrong)
            continue
        strike = Strike(blow.joint, (float(point[0]), float(point[1]), float(point[2])), frame)
        maker.add(action, Label(behaviour, action, side), q, blow.source, strike=strike)
