"""Made jumps on the spot: crouch, push off over the toes, free flight, landing, stand."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

from shared.data.make_stand import idle
from shared.data.splice import local_rotations
from shared.motion.body import SIDES, SOLE_UNDER_BALL_M, Array, J, left_axis
from shared.motion.kinematics import forward_kinematics
from shared.motion.limbs import solve_leg, unlock_arms
from shared.motion.rotations import matrix_from_axis_angle
from shared.motion.skeleton import CANONICAL
from shared.protocol.rates import CORPUS_FPS as FPS

_GRAVITY = 9.81


def jump_on_spot(pose: Array, rng: np.random.Generator) -> Array:
    """(T, 22, 3) a jump straight up from the stand `pose` (22, 3) and back into it.

    The pelvis follows cubics through crouch, take-off and landing with the velocities that the height of the flight
    asks for, a parabola between; the toes stay planted until take-off; trunk and arms swing along.
    """
    height = rng.uniform(0.12, 0.20)
    crouch, absorb = rng.uniform(0.17, 0.28), rng.uniform(0.12, 0.22)
    rise = 0.075  # heels off the ground and legs straight at take-off
    speed = float(np.sqrt(2 * _GRAVITY * height))
    before, after = rng.uniform(0.5, 1.2), rng.uniform(0.8, 1.4)
    down = rng.uniform(0.45, 0.65)
    push = 1.9 * (crouch + rise) / speed
    flight = 2 * speed / _GRAVITY
    catch = 1.9 * (absorb + rise) / speed
    up = rng.uniform(0.5, 0.75)
    marks = np.cumsum([0.0, before, down, push, flight, catch, up, after])
    off, land, end = marks[3], marks[4], marks[7]
    t = np.arange(int(end * FPS)) / FPS

    levels = [0.0, 0.0, -crouch, rise, rise, -absorb, 0.0, 0.0]
    slopes = [0.0, 0.0, 0.0, speed, -speed, 0.0, 0.0, 0.0]
    z = CubicHermiteSpline(marks, levels, slopes)(t)
    air = (t > off) & (t < land)
    s = t[air] - off
    z[air] = rise + speed * s - 0.5 * _GRAVITY * s * s
    lift = np.where(air, np.clip(z - rise, 0.0, None), 0.0)

    def curve(values: list[float]) -> Array:
        return np.asarray(PchipInterpolator(marks, values)(t))

    depth, give = np.radians(rng.uniform(18, 34)), np.radians(rng.uniform(12, 24))
    lean = curve([0.0, 0.0, depth, 0.02, 0.05, give, 0.0, 0.0])
    pitch = np.interp(t, [off - 0.6 * push, off, land - 0.3 * flight, land, land + 0.1], [0.0, 0.75, 0.45, 0.3, 0.0])
    reach = np.radians(rng.uniform(55, 120))
    swing = curve([0.0, 0.0, -np.radians(rng.uniform(25, 45)), reach, 0.8 * reach, 0.25, 0.0, 0.0])

    base = idle(pose, len(t), rng, 0.5)
    left = left_axis(base)
    local = local_rotations(base)
    local[:, 0] = matrix_from_axis_angle(left, lean) @ local[:, 0]
    y = np.array([0.0, 1.0, 0.0])
    local[:, J["spine1"]] = local[:, J["spine1"]] @ matrix_from_axis_angle(y, 0.35 * lean)
    local[:, J["spine2"]] = local[:, J["spine2"]] @ matrix_from_axis_angle(y, 0.2 * lean)
    local[:, J["neck"]] = local[:, J["neck"]] @ matrix_from_axis_angle(y, -0.6 * lean)
    for side in SIDES:
        # The collar's frame is the chest's: a turn about -Y swings the hanging arm forward.
        shoulder = J[f"{side}_shoulder"]
        local[:, shoulder] = matrix_from_axis_angle(y, -swing) @ local[:, shoulder]
    forward = np.cross(left, [0.0, 0.0, 1.0])
    root = base[:, 0] + z[:, None] * [0.0, 0.0, 1.0] - (0.32 * np.clip(-z, 0.0, None))[:, None] * forward
    p, _ = forward_kinematics(CANONICAL, root, local)
    for side in SIDES:
        toe = pose[J[f"{side}_foot"]].copy()
        toe[2] = SOLE_UNDER_BALL_M
        flat = pose[J[f"{side}_foot"]] - pose[J[f"{side}_ankle"]]
        foot = np.einsum("tij,j->ti", matrix_from_axis_angle(left, pitch), flat)
        target = toe + lift[:, None] * [0.0, 0.0, 1.0] - foot
        p[:, J[f"{side}_foot"]] = p[:, J[f"{side}_ankle"]] + foot
        p = solve_leg(p, side, target)
        p[:, J[f"{side}_foot"]] = p[:, J[f"{side}_ankle"]] + foot
    return unlock_arms(p)
