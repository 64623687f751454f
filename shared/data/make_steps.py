"""Made steps from one stand to another: side steps, steps back and forward, stepping into a stance."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d

from shared.data.balance import on_feet
from shared.data.make_stand import SWAY_RAD, ease, wander
from shared.data.splice import local_rotations
from shared.motion.body import SIDES, SOLE_UNDER_ANKLE_M, Array, J, heading_rad, place
from shared.motion.heading import heading_of
from shared.motion.rotations import matrix_about_z, matrix_from_rotvec, rotvec_from_matrix, wrap_angle
from shared.protocol.rates import CORPUS_FPS as FPS

_LONGEST_STEP_M = 0.5


def blended(a: Array, b: Array, w: Array) -> Array:
    """Local rotations (T, J, 3, 3) from a to b (each (J, 3, 3) or (T, J, 3, 3)) by weights (T,)."""
    a, b = np.broadcast_arrays(a, b)
    turn = rotvec_from_matrix(np.swapaxes(a, -1, -2) @ b)
    return np.asarray(a @ matrix_from_rotvec(np.broadcast_to(w[:, None, None], (len(w), *turn.shape[-2:])) * turn))


def swayed(local: Array, rng: np.random.Generator, size: float = 1.0) -> Array:
    """Local rotations with the small slow motion of a living trunk and arms."""
    out = local.copy()
    for name, angle in SWAY_RAD.items():
        out[:, J[name]] = out[:, J[name]] @ matrix_from_rotvec(size * angle * wander(rng, len(out), 3))
    return out


def moved(pose: Array, ahead_m: float, left_m: float, turn_rad: float = 0.0) -> Array:
    """(22, 3) the pose moved along and across its own heading, turned about its pelvis."""
    yaw = float(heading_rad(pose[None])[0])
    c, s = np.cos(yaw), np.sin(yaw)
    shift = np.array([c * ahead_m - s * left_m, s * ahead_m + c * left_m])
    return place(pose[None], turn_rad, shift, pose[0, :2])[0]


def step_to(
    a: Array, b: Array, rng: np.random.Generator, rest: tuple[float, float] = (0.5, 0.8), period: float | None = None
) -> Array:
    """A stand that steps over into another one, foot by foot, in as many steps as their distance asks for.

    The foot on the side it goes to steps first; the weight is on the other one; both feet stand flat before and after.

    Args:
        a, b: (22, 3) standing poses; only the feet of b that differ from those of a by a centimetre or more step.
        rest: seconds of standing before and after. period: of a step, in seconds.
    """
    yaw_a = float(heading_rad(a[None])[0])
    turn = float(wrap_angle(heading_rad(b[None])[0] - yaw_a))
    way = {side: b[J[f"{side}_ankle"], :2] - a[J[f"{side}_ankle"], :2] for side in SIDES}
    far = max(float(np.linalg.norm(way[side])) for side in SIDES)
    steps = max(1, int(np.ceil(far / (_LONGEST_STEP_M * rng.uniform(0.75, 1.0)))))
    middle = 0.5 * (way["left"] + way["right"])
    leftward = float(middle @ np.array([-np.sin(yaw_a), np.cos(yaw_a)])) + 0.2 * turn
    first = "left" if leftward > 0.05 or (leftward > -0.05 and rng.random() < 0.5) else "right"
    order = (first, "right" if first == "left" else "left")
    moving = [s for s in order if np.linalg.norm(b[J[f"{s}_ankle"]] - a[J[f"{s}_ankle"]]) > 0.01 or abs(turn) > 0.05]
    swings = [(side, (k + 1) / steps) for k in range(steps) for side in moving]
    if steps > 1 and len(moving) == 2 and abs(leftward) < 0.3 * far:
        # Along the body's own line the feet pass each other; sideways one follows the other.
        swings = [(moving[k % 2], (k + 1) / (2 * steps)) for k in range(2 * steps)] + [(moving[0], 1.0)]
    n = round((period or rng.uniform(0.42, 0.58)) * FPS)
    lead, tail = int(rest[0] * FPS), int(rest[1] * FPS)
    frames = lead + n * len(swings) + tail
    lift = rng.uniform(0.05, 0.08)
    share = {side: np.zeros(frames) for side in SIDES}
    height = {side: np.zeros(frames) for side in SIDES}
    weight = np.zeros(frames)  # +1 over the left foot, -1 over the right
    x = (np.arange(n) + 1) / n
    air = ease(np.clip((x - 0.1) / 0.8, 0.0, 1.0))
    for i, (side, goal) in enumerate(swings):
        at = lead + i * n
        was = share[side][at - 1] if at else 0.0
        share[side][at : at + n] = was + (goal - was) * air
        share[side][at + n :] = goal
        height[side][at : at + n] = lift * np.sin(np.pi * air) ** 2
        weight[at : at + n] = 1.0 if side == "right" else -1.0
    for side in set(SIDES) - set(moving):
        share[side][:] = np.clip((np.arange(frames) - lead) / max(frames - lead - tail, 1), 0.0, 1.0)
    weight = gaussian_filter1d(weight, 4.0, mode="nearest")
    body = gaussian_filter1d(0.5 * (share["left"] + share["right"]), 3.5, mode="nearest")
    ankles, feet = {}, {}
    for side in SIDES:
        start, stop = a[J[f"{side}_ankle"]], b[J[f"{side}_ankle"]]
        ankles[side] = start + share[side][:, None] * (stop - start)
        ankles[side][:, 2] += height[side]
        toe_a, toe_b = (q[J[f"{side}_foot"]] - q[J[f"{side}_ankle"]] for q in (a, b))
        angle = float(wrap_angle(heading_of(toe_b) - heading_of(toe_a)))
        turned = np.einsum("tij,j->ti", matrix_about_z(share[side] * angle), toe_a)
        turned[:, 2] += share[side] * (toe_b[2] - toe_a[2])
        feet[side] = turned
    local_a, local_b = local_rotations(a[None])[0], local_rotations(b[None])[0]
    local_a[0] = matrix_about_z(np.array(-yaw_a)) @ local_a[0]
    local_b[0] = matrix_about_z(np.array(-yaw_a - turn)) @ local_b[0]
    local = swayed(blended(local_a, local_b, body), rng)
    yaw = yaw_a + turn * body
    local[:, 0] = matrix_about_z(yaw) @ local[:, 0]
    offsets = []
    for q, heading in ((a, yaw_a), (b, yaw_a + turn)):
        middle = 0.5 * (q[J["left_ankle"], :2] + q[J["right_ankle"], :2])
        offsets.append(matrix_about_z(np.array(-heading))[:2, :2] @ (q[0, :2] - middle))
    local_offset = offsets[0] + body[:, None] * (offsets[1] - offsets[0])
    centre = gaussian_filter1d(0.5 * (ankles["left"][:, :2] + ankles["right"][:, :2]), 3.0, axis=0, mode="nearest")
    across = 0.5 * (ankles["left"][:, :2] - ankles["right"][:, :2])
    root = np.empty((frames, 3))
    root[:, :2] = centre + np.einsum("tij,tj->ti", matrix_about_z(yaw)[:, :2, :2], local_offset)
    root[:, :2] += 0.45 * weight[:, None] * across + 0.004 * wander(rng, frames, 2)
    root[:, 2] = a[0, 2] + body * (b[0, 2] - a[0, 2]) - 0.012 * gaussian_filter1d(np.abs(weight), 3.0, mode="nearest")
    return on_feet(local, root, ankles, feet)


def flat_footed(pose: Array) -> Array:
    """(22, 3) the pose with its ankles at the height of a flat foot, as far as the legs reach."""
    out = pose.copy()
    ankles, feet = {}, {}
    for side in SIDES:
        at = pose[J[f"{side}_ankle"]].copy()
        at[2] = SOLE_UNDER_ANKLE_M
        ankles[side] = at[None]
        toe = pose[J[f"{side}_foot"]] - pose[J[f"{side}_ankle"]]
        flat = np.array([toe[0], toe[1], 0.0])
        down = -0.05
        length = float(np.linalg.norm(toe))
        feet[side] = (flat / np.linalg.norm(flat) * np.sqrt(length**2 - down**2) + np.array([0.0, 0.0, down]))[None]
    return on_feet(local_rotations(out[None]), out[None, 0], ankles, feet)[0]
