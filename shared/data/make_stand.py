"""Made motion around a stand: idling with sway, stepping round on the spot, waving."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter1d

from shared.data.splice import local_rotations
from shared.motion.body import SIDES, SOLE_UNDER_ANKLE_M, Array, J, velocity
from shared.motion.kinematics import forward_kinematics
from shared.motion.limbs import MIN_BEND_RAD, reach, solve_leg
from shared.motion.rotations import matrix_about_z, matrix_from_rotvec, normalize
from shared.motion.skeleton import CANONICAL
from shared.protocol.rates import CORPUS_FPS as FPS

SWAY_RAD = {"spine1": 0.008, "spine2": 0.006, "neck": 0.035, "left_shoulder": 0.018, "right_shoulder": 0.018,
             "left_elbow": 0.03, "right_elbow": 0.03}  # fmt: skip


def quiet_frames(p: Array) -> npt.NDArray[np.int64]:
    """Indices of frames of a relaxed upright stand: all joints slow, feet on the floor, hands low."""
    speed = np.linalg.norm(velocity(p, FPS), axis=-1).max(axis=-1)
    feet = np.maximum(p[:, J["left_ankle"], 2], p[:, J["right_ankle"], 2])
    hands = np.maximum(p[:, J["left_wrist"], 2], p[:, J["right_wrist"], 2])
    lean = normalize(p[:, J["neck"]] - p[:, J["pelvis"]])[:, 2]
    stance = np.linalg.norm(p[:, J["left_ankle"], :2] - p[:, J["right_ankle"], :2], axis=-1)
    mask = (speed < 0.2) & (feet < 0.09) & (hands < p[:, J["spine1"], 2]) & (lean > 0.97) & (p[:, 0, 2] > 0.9)
    return np.flatnonzero(mask & (stance < 0.4) & (stance > 0.1))


def wander(rng: np.random.Generator, frames: int, channels: int, low_hz: float = 0.08, high_hz: float = 0.45) -> Array:
    """(frames, channels) slow noise of unit size: four sines of random rate and phase."""
    t = np.arange(frames)[:, None, None] / FPS
    rate = rng.uniform(low_hz, high_hz, (1, 4, channels))
    phase = rng.uniform(0, 2 * np.pi, (1, 4, channels))
    return np.asarray(np.sin(2 * np.pi * rate * t + phase).sum(axis=1) / np.sqrt(2.0))


def idle(pose: Array, frames: int, rng: np.random.Generator, sway: float = 1.0) -> Array:
    """(frames, 22, 3) a stand in about the pose (22, 3): the body sways and breathes over planted feet."""
    local = np.repeat(local_rotations(pose[None]), frames, axis=0)
    for name, size in SWAY_RAD.items():
        local[:, J[name]] = local[:, J[name]] @ matrix_from_rotvec(sway * size * wander(rng, frames, 3))
    shift = sway * wander(rng, frames, 3) * np.array([0.007, 0.009, 0.001])
    yaw = sway * 0.012 * wander(rng, frames, 1)[:, 0]
    local[:, 0] = matrix_about_z(yaw) @ local[:, 0]
    # A hand's breadth of sway must leave the knees their least bend.
    room = min(
        reach(*_leg(side)) ** 2 - float(np.sum((pose[J[f"{side}_hip"], :2] - pose[J[f"{side}_ankle"], :2]) ** 2))
        for side in SIDES
    )
    height = min(pose[0, 2], float(np.sqrt(max(room, 0.25))) + pose[0, 2] - pose[J["left_hip"], 2] + 0.064)
    root = np.array([pose[0, 0], pose[0, 1], height]) + shift
    p, _ = forward_kinematics(CANONICAL, root, local)
    return _plant(p, {side: np.repeat(pose[None, J[f"{side}_ankle"]], frames, axis=0) for side in SIDES},
                  {side: np.repeat((pose[J[f"{side}_foot"]] - pose[J[f"{side}_ankle"]])[None], frames, axis=0)
                   for side in SIDES})  # fmt: skip


def _leg(side: str) -> tuple[float, float]:
    lengths = CANONICAL.bone_lengths_m
    return float(lengths[J[f"{side}_knee"]]), float(lengths[J[f"{side}_ankle"]])


def _plant(p: Array, ankles: dict[str, Array], feet: dict[str, Array]) -> Array:
    """Legs solved for ankle targets (T, 3), with given foot vectors (T, 3)."""
    out = p.copy()
    for side in SIDES:
        out[:, J[f"{side}_foot"]] = out[:, J[f"{side}_ankle"]] + feet[side]
        out = solve_leg(out, side, ankles[side])
        out[:, J[f"{side}_foot"]] = out[:, J[f"{side}_ankle"]] + feet[side]
    return out


def ease(x: Array) -> Array:
    x = np.clip(x, 0.0, 1.0)
    return np.asarray(x**3 * (10 - 15 * x + 6 * x * x))


def turn_on_spot(
    pose: Array, angle_rad: float, rng: np.random.Generator, rest: tuple[float, float] = (0.8, 1.0)
) -> Array:
    """A stand that steps round by `angle_rad` (positive left) and stands again.

    The foot on the inside of the turn opens first, the other closes; a step turns a foot by up to about 50 degrees and
    takes about half a second, the weight goes to the standing foot, the head leads a little.

    Args:
        pose: (22, 3) a stand.
        rest: seconds of standing before and after.
    """
    steps = max(1, int(np.ceil(abs(angle_rad) / np.radians(rng.uniform(42, 58)))))
    period = rng.uniform(0.42, 0.56)
    lift = rng.uniform(0.05, 0.085)
    order = ("left", "right") if angle_rad > 0 else ("right", "left")
    swing = [(side, k) for k in range(steps) for side in order]
    lead, tail = int(rest[0] * FPS), int(rest[1] * FPS)
    step_frames = round(period * FPS)
    frames = lead + step_frames * len(swing) + tail
    base = idle(pose, frames, rng)

    centre = 0.5 * (pose[J["left_ankle"], :2] + pose[J["right_ankle"], :2])
    drift = rng.normal(0.0, 0.02, 2)
    stance = {side: pose[J[f"{side}_ankle"], :2] - centre for side in SIDES}
    toes = {side: pose[J[f"{side}_foot"]] - pose[J[f"{side}_ankle"]] for side in SIDES}
    yaw = {side: np.zeros(frames) for side in SIDES}
    height = {side: np.zeros(frames) for side in SIDES}
    weight = np.zeros(frames)  # +1 over the left foot, -1 over the right
    for n, (side, k) in enumerate(swing):
        a = lead + n * step_frames
        x = (np.arange(step_frames) + 1) / step_frames
        # The foot is off the ground in the middle four fifths of its step.
        air = np.clip((x - 0.1) / 0.8, 0.0, 1.0)
        goal = angle_rad * (k + 1) / steps
        yaw[side][a : a + step_frames] = yaw[side][a - 1] + (goal - yaw[side][a - 1]) * ease(air)
        yaw[side][a + step_frames :] = goal
        height[side][a : a + step_frames] = lift * np.sin(np.pi * ease(air)) ** 2
        weight[a : a + step_frames] = 1.0 if side == "right" else -1.0
    weight = gaussian_filter1d(weight, 3.5, mode="nearest")
    body = gaussian_filter1d(0.5 * (yaw["left"] + yaw["right"]), 3.0, mode="nearest")
    ahead = gaussian_filter1d(np.concatenate([body[6:], np.repeat(body[-1:], 6)]), 2.0, mode="nearest")

    def about(vector: Array, angle: Array) -> Array:
        return np.stack(
            [
                np.cos(angle) * vector[0] - np.sin(angle) * vector[1],
                np.sin(angle) * vector[0] + np.cos(angle) * vector[1],
            ],
            axis=-1,
        )

    move = centre + drift * ease(body[:, None] / angle_rad)
    ankles, feet = {}, {}
    for side in SIDES:
        xy = move + about(stance[side], yaw[side])
        ankles[side] = np.concatenate([xy, (SOLE_UNDER_ANKLE_M + height[side])[:, None]], axis=-1)
        flat = about(toes[side][:2], yaw[side])
        feet[side] = np.concatenate([flat, np.full((frames, 1), toes[side][2])], axis=-1)
    local = local_rotations(base)
    local[:, 0] = matrix_about_z(body) @ local[:, 0]
    head_lead = np.clip(ahead - body, -0.5, 0.5)
    local[:, J["neck"]] = matrix_about_z(0.7 * head_lead) @ local[:, J["neck"]]
    local[:, J["spine2"]] = matrix_about_z(0.3 * head_lead) @ local[:, J["spine2"]]
    offset = base[:, 0, :2] - centre
    root = np.empty((frames, 3))
    across = 0.5 * (ankles["left"][:, :2] - ankles["right"][:, :2])
    root[:, :2] = move + np.stack(
        [np.cos(body) * offset[:, 0] - np.sin(body) * offset[:, 1],
         np.sin(body) * offset[:, 0] + np.cos(body) * offset[:, 1]], axis=-1
    ) + 0.45 * weight[:, None] * across  # fmt: skip
    root[:, 2] = base[:, 0, 2] - 0.012 * gaussian_filter1d(np.abs(weight), 3.0, mode="nearest")
    p, _ = forward_kinematics(CANONICAL, root, local)
    return _plant(p, ankles, feet)


def _chest_axes(p: Array) -> tuple[Array, Array, Array]:
    """Forward, left and up unit vectors (T, 3) of the chest."""
    left = normalize(p[:, J["left_shoulder"]] - p[:, J["right_shoulder"]])
    up = normalize(p[:, J["neck"]] - p[:, J["spine2"]])
    up = normalize(up - np.sum(up * left, axis=-1, keepdims=True) * left)
    return np.cross(left, up), left, up


def _slerp(a: Array, b: Array, w: Array) -> Array:
    """Unit vectors (T, 3) from a to b by weights (T,)."""
    angle = np.arccos(np.clip(np.sum(a * b, axis=-1), -1.0, 1.0))
    s = np.maximum(np.sin(angle), 1e-6)
    wa, wb = np.sin((1 - w) * angle) / s, np.sin(w * angle) / s
    return normalize(wa[:, None] * a + wb[:, None] * b)


def wave(p: Array, side: str, rng: np.random.Generator, start_s: float, stop_s: float) -> Array:
    """The motion with one arm raised and waving between two times; the wrist goes to and fro above the shoulder.

    Args:
        p: (T, 22, 3) any upright motion.
        side: 'left' or 'right'.
        start_s, stop_s: when the arm begins to rise and to fall; before 0 or past the end the arm is up throughout.
    """
    t = np.arange(len(p)) / FPS
    # One way of waving, a little varied: of many rates and phases a planner learns the mean, an arm that is held up.
    rise, fall = rng.uniform(0.55, 0.65), rng.uniform(0.55, 0.8)
    w = ease((t - start_s) / rise) * (1 - ease((t - stop_s) / fall))
    forward, left, up = _chest_axes(p)
    out = left if side == "left" else -left
    elevation, azimuth = np.radians(rng.uniform(-12, 18)), np.radians(rng.uniform(15, 45))
    frequency, swing = rng.uniform(1.2, 1.3), np.radians(rng.uniform(25, 33))
    phase = 2 * np.pi * frequency * (t - start_s - 0.5 * rise)
    tilt, nod = np.radians(rng.uniform(-6, 4)), np.radians(rng.uniform(8, 20))
    lift = elevation + 0.18 * swing * np.sin(phase + 0.6)
    upper = np.cos(lift)[:, None] * (np.cos(azimuth) * out + np.sin(azimuth) * forward) + np.sin(lift)[:, None] * up
    angle = tilt + swing * np.sin(phase)
    fore = normalize(np.sin(angle)[:, None] * out + np.cos(angle)[:, None] * up + np.sin(nod) * forward)
    shoulder, elbow, wrist = (J[f"{side}_{n}"] for n in ("shoulder", "elbow", "wrist"))
    lengths = CANONICAL.bone_lengths_m
    u0 = normalize(p[:, elbow] - p[:, shoulder])
    f0 = normalize(p[:, wrist] - p[:, elbow])
    u = _slerp(u0, upper, w)
    # The forearm goes ahead of the upper arm, so that the hand rises along the body and not in a wide arc.
    f = _slerp(f0, fore, np.clip(1.15 * w, 0.0, 1.0))
    straight = np.sum(u * f, axis=-1)
    limit = np.cos(MIN_BEND_RAD)
    flexed = normalize(f - straight[:, None] * u + 1e-6 * forward)
    f = np.where((straight > limit)[:, None], limit * u + np.sin(MIN_BEND_RAD) * flexed, f)
    q = p.copy()
    q[:, elbow] = q[:, shoulder] + lengths[elbow] * u
    q[:, wrist] = q[:, elbow] + lengths[wrist] * f
    return q
