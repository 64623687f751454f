"""What the kinematics of a clip show: standing, walking, running, turning, jumping, and to which side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter1d

from shared.motion.body import Array, heading_rad, runs, sole_height, velocity
from shared.motion.rotations import rotvec_from_matrix, wrap_angle
from shared.protocol.rates import CORPUS_FPS

STAND_MPS = 0.2
RUN_MPS = 2.0
SLOW_MPS = 0.75
FAST_MPS = 1.45
_TURN_RAD_S = 0.7
_JUMP_M = 0.05


@dataclass(frozen=True)
class Label:
    """A behaviour and the action (key into texts.SENTENCES) with its side."""

    behaviour: str
    action: str
    side: str = ""


def path_speed(p: Array, fps: float = CORPUS_FPS) -> Array:
    """(T,) horizontal speed of the pelvis, smoothed over a step."""
    v = velocity(gaussian_filter1d(p[:, 0, :2], 6.0, axis=0, mode="nearest"), fps)
    return np.asarray(np.linalg.norm(v, axis=-1))


def turned_rad(p: Array) -> float:
    """Change of the pelvis' heading over the clip, smoothed; positive to the left."""
    yaw = gaussian_filter1d(heading_rad(p), 6.0, mode="nearest")
    return float(yaw[-1] - yaw[0])


def airborne(p: Array) -> np.ndarray:
    """(T,) both feet clear of the floor by more than 5 cm."""
    return np.asarray(sole_height(p).min(axis=-1) > _JUMP_M)


def side_of(angle: float) -> str:
    """The side a positive (left) or negative (right) angle turns to."""
    return "left" if angle > 0 else "right"


def locomotion_label(p: Array, fps: float = CORPUS_FPS) -> Label:
    """Label of a piece of standing, walking, running or turning, by speed, direction and change of heading."""
    speed = path_speed(p, fps)
    mean = float(speed.mean())
    turn = turned_rad(p)
    seconds = len(p) / fps
    travelled = float(np.linalg.norm(p[-1, 0, :2] - p[0, 0, :2]))
    if mean < STAND_MPS or (mean < 0.35 and travelled < 0.3):
        if abs(turn) > np.radians(140):
            return Label("turn", "turn_around", side_of(turn))
        if abs(turn) > np.radians(40):
            return Label("turn", "turn", side_of(turn))
        return Label("stand", "stand")
    yaw = heading_rad(p)
    v = velocity(gaussian_filter1d(p[:, 0, :2], 6.0, axis=0, mode="nearest"), fps)
    ahead = float(np.mean(v[:, 0] * np.cos(yaw) + v[:, 1] * np.sin(yaw)))
    leftward = float(np.mean(-v[:, 0] * np.sin(yaw) + v[:, 1] * np.cos(yaw)))
    if mean > RUN_MPS or (mean > 1.7 and airborne_share(p) > 0.05):
        if abs(turn) > np.radians(200):
            return Label("run", "run_circle", side_of(turn))
        if abs(turn) > np.radians(40):
            return Label("run", "run_curve", side_of(turn))
        return Label("run", "run")
    if abs(turn) < np.radians(60) and ahead < -0.15 and abs(ahead) > abs(leftward):
        return Label("step_back", "walk_back")
    if abs(turn) < np.radians(60) and abs(leftward) > 0.2 and abs(leftward) > 1.5 * abs(ahead):
        return Label("step_side", "walk_side", side_of(leftward))
    starts, ends = speed[:10].mean() < STAND_MPS, speed[-10:].mean() < STAND_MPS
    if abs(turn) > np.radians(200) and seconds > 4:
        return Label("walk", "walk_circle", side_of(turn))
    if abs(turn) > np.radians(50) and _sharpest_rad(yaw) > np.radians(75):
        return Label("turn", "walk_uturn" if abs(turn) > np.radians(110) else "walk_turn", side_of(turn))
    if abs(turn) > np.radians(140):
        return Label("walk", "walk_uturn", side_of(turn))
    if abs(turn) > np.radians(35):
        return Label("walk", "walk_curve", side_of(turn))
    if starts or ends:
        return Label("walk", "walk_start_stop" if starts and ends else "walk_start" if starts else "walk_stop")
    if mean < SLOW_MPS:
        return Label("walk", "walk_slow")
    return Label("walk", "walk_fast" if mean > FAST_MPS else "walk")


def _sharpest_rad(yaw: Array, fps: float = CORPUS_FPS, seconds: float = 1.5) -> float:
    """Largest change of heading within `seconds`."""
    n = min(int(seconds * fps), len(yaw) - 1)
    smooth = gaussian_filter1d(yaw, 4.0, mode="nearest")
    return float(np.abs(smooth[n:] - smooth[:-n]).max()) if n > 0 else 0.0


def airborne_share(p: Array) -> float:
    """Share of frames in which both feet are at least 2 cm off the floor."""
    return float(np.mean(sole_height(p).min(axis=-1) > 0.02))


def jump_label(p: Array) -> Label:
    """Label of a clip known to hold jumps, by where the body goes in the air."""
    air = runs(airborne(p))
    if not air:
        return Label("jump", "jump")
    a, b = max(air, key=lambda r: r[1] - r[0])
    a, b = max(a - 3, 0), min(b + 3, len(p) - 1)
    yaw = float(heading_rad(p[a : a + 1])[0])
    move = p[b, 0, :2] - p[a, 0, :2]
    ahead = float(move @ np.array([np.cos(yaw), np.sin(yaw)]))
    leftward = float(move @ np.array([-np.sin(yaw), np.cos(yaw)]))
    turn = float(wrap_angle(turned_rad(p)))
    if abs(turn) > np.radians(50):
        return Label("jump", "jump_turn", side_of(turn))
    if abs(leftward) > 0.25 and abs(leftward) > abs(ahead):
        return Label("jump", "jump_side", side_of(leftward))
    return Label("jump", "jump_forward") if ahead > 0.3 else Label("jump", "jump")


def segment_locomotion(
    p: Array, fps: float = CORPUS_FPS, shortest_s: float = 2.0, longest_s: float = 8.0
) -> list[tuple[int, int]]:
    """Half-open pieces of a locomotion take, cut where speed class or turning changes, none under `shortest_s`."""
    speed = path_speed(p, fps)
    yaw_rate = velocity(gaussian_filter1d(heading_rad(p), 9.0, mode="nearest"), fps)
    kind = np.digitize(speed, [STAND_MPS, RUN_MPS])
    turning = np.where(np.abs(yaw_rate) > _TURN_RAD_S, np.sign(yaw_rate), 0).astype(int)
    state = 3 * (3 * kind + _direction(p, fps)) + turning + 1
    cuts = [0, *(np.flatnonzero(np.diff(state)) + 1).tolist(), len(p)]
    pieces = list(zip(cuts[:-1], cuts[1:], strict=True))
    short = int(shortest_s * fps)
    # The shortest piece joins its shorter neighbour until all are long enough.
    while len(pieces) > 1:
        k = min(range(len(pieces)), key=lambda i: pieces[i][1] - pieces[i][0])
        if pieces[k][1] - pieces[k][0] >= short:
            break
        left = pieces[k - 1] if k > 0 else None
        right = pieces[k + 1] if k + 1 < len(pieces) else None
        if right is None or (left is not None and left[1] - left[0] <= right[1] - right[0]):
            pieces[k - 1 : k + 1] = [(pieces[k - 1][0], pieces[k][1])]
        else:
            pieces[k : k + 2] = [(pieces[k][0], pieces[k + 1][1])]
    return [q for piece in pieces for q in chunks(*piece, int(longest_s * fps), short)]


def _direction(p: Array, fps: float) -> npt.NDArray[np.int64]:
    """(T,) 0 where the body goes ahead or stands, 1 where it goes backward, 2 where it goes sideways."""
    v = velocity(gaussian_filter1d(p[:, 0, :2], 8.0, axis=0, mode="nearest"), fps)
    yaw = gaussian_filter1d(heading_rad(p), 8.0, mode="nearest")
    ahead = v[:, 0] * np.cos(yaw) + v[:, 1] * np.sin(yaw)
    across = np.abs(-v[:, 0] * np.sin(yaw) + v[:, 1] * np.cos(yaw))
    sideways = (across > 0.25) & (across > 1.2 * np.abs(ahead))
    return np.where(sideways, 2, np.where(ahead < -0.3, 1, 0))


def chunks(start: int, stop: int, longest: int, shortest: int) -> list[tuple[int, int]]:
    """A range cut into equal parts of at most `longest`, at least `shortest` frames."""
    n = max(1, int(np.ceil((stop - start) / longest)))
    while n > 1 and (stop - start) // n < shortest:
        n -= 1
    edges = np.linspace(start, stop, n + 1).round().astype(int).tolist()
    return list(zip(edges[:-1], edges[1:], strict=True))


def rotation_steps_rad(local: Array) -> Array:
    """(T-1, J) angle by which each joint's rotation changes from frame to frame. local: (T, J, 3, 3)."""
    step = np.swapaxes(local[:-1], -1, -2) @ local[1:]
    return np.asarray(np.linalg.norm(rotvec_from_matrix(step), axis=-1))
