"""`eval planner --suite rollouts`: a minute of motion from each of twenty prompts; `--suite switches`: changed prompts.

Both without physics, the planner's own motion its next prefix, many bodies in a batch. The rules are in
docs/experiments_planner.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from planner_service.training.evaluate_quality import quality
from planner_service.training.rollout import Rollout
from shared.errors import SimulationError
from shared.motion.ik import standing_clip
from shared.motion.metrics import sole_points
from shared.motion.skeleton import CANONICAL
from shared.plugins.interfaces import Planner
from shared.protocol.rates import PLANNER_FPS as FPS
from shared.protocol.rates import TICK_HZ
from shared.tasks.first_movement import first_movement
from shared.tasks.interface import PlanGoal

Array = npt.NDArray[np.float64]
Advance = Callable[[int], None]


@dataclass(frozen=True)
class Prompt:
    """A text to go on from for a minute.

    Attributes:
        moving: whether it asks for movement that goes on, so that standing still is freezing.
        upright: whether it is done on the feet, so that a head that comes down is drifting into the floor.
    """

    text: str
    moving: bool = True
    upright: bool = True


PROMPTS = (
    Prompt("a person walks forward."),
    Prompt("a person is running."),
    Prompt("a person walks slowly."),
    Prompt("someone walks briskly."),
    Prompt("a person walks backwards."),
    Prompt("a person walks sideways to the left."),
    Prompt("a person walks in a circle to the right."),
    Prompt("a person jogs in a circle to the left."),
    Prompt("a person turns to the left."),
    Prompt("a person waves with the right hand."),
    Prompt("a person waves with both arms."),
    Prompt("a person jumps up and down."),
    Prompt("a person dances salsa."),
    Prompt("a person sneaks forward.", upright=False),
    Prompt("a person is boxing."),
    Prompt("a person kicks with the right foot."),
    Prompt("a person does squats.", upright=False),
    Prompt("a person does jumping jacks."),
    Prompt("a person is standing still.", moving=False),
    Prompt("a person walks, then stops.", moving=False),
)

STILL_S, STILL_M = 5.0, 0.02
"""Frozen: for so long no joint leaves a ball of this radius about its mean place."""
SUNK_M, RAISED_M, LONG_S = 0.05, 0.2, 1.0
"""Drifted: the mean height of the lowest sole point over LONG_S is below -SUNK_M, or above RAISED_M ..."""
HEAD_SHARE = 0.75
"""... or, of those on their feet, the head stays below this share of its standing height all that time."""
JOINT_MPS, ROOT_MPS, ROOT_M = 15.0, 6.0, 2.0
"""Exploded: a joint or the pelvis is faster than that, the pelvis higher, or a number not finite."""


def troubles(positions_w_m: Array, prompt: Prompt) -> dict[str, float]:
    """What went wrong in a rollout (T, 22, 3) at 20 fps, with the second at which it first did; empty where nothing."""
    out: dict[str, float] = {}
    p = np.asarray(positions_w_m, dtype=np.float64)
    finite = np.isfinite(p).all(axis=(1, 2))
    if not finite.all():
        return {"exploded": float(np.argmin(finite)) / FPS}
    speed = np.linalg.norm(np.diff(p, axis=0), axis=-1) * FPS
    wild = (speed.max(-1) > JOINT_MPS) | (speed[:, 0] > ROOT_MPS) | (p[1:, 0, 2] > ROOT_M)
    if wild.any():
        out["exploded"] = float(np.argmax(wild)) / FPS
    long = round(LONG_S * FPS)
    height = _sliding(sole_points(p)[..., 2].min(-1), long).mean(-1)
    drifted = (height < -SUNK_M) | (height > RAISED_M)
    if prompt.upright:
        head = CANONICAL.index("head")
        standing = float(CANONICAL.rest_positions_m[head, 2])
        drifted |= _sliding(p[:, head, 2], long).max(-1) < HEAD_SHARE * standing
    if drifted.any():
        out["drifted"] = float(np.argmax(drifted)) / FPS
    if prompt.moving:
        still = _still(p)
        if still is not None:
            out["froze"] = still
    return out


def rollouts(
    planner: Planner, seed: int, seconds: int = 60, replan_frames: int = 20, advance: Advance = lambda count: None
) -> tuple[dict[str, object], list[tuple[str, Array]]]:
    """Every prompt for `seconds`, from standing; also motions to look at.

    Returns:
        {rollouts, good, frozen, drifted, exploded, rows: [{text, froze | drifted | exploded: second, quality ...}]}.
    """
    start = np.repeat(standing_clip(planner.spec.prefix_frames, FPS).positions_w_m[None], len(PROMPTS), 0)
    rollout = Rollout(planner, start, seed, replan_frames)
    failed: str | None = None
    while rollout.tick < seconds * TICK_HZ:
        try:
            rollout.step(lambda body, view: PlanGoal(text=PROMPTS[body].text))
        except SimulationError as error:
            failed = f"{error} at {rollout.tick / TICK_HZ:.1f} s"
            break
        advance(len(PROMPTS))
    rows: list[dict[str, object]] = []
    shown = []
    for body, prompt in enumerate(PROMPTS):
        motion = rollout.frames(body)[planner.spec.prefix_frames - 1 :]
        found = troubles(motion, prompt)
        way = float(np.linalg.norm(np.diff(motion[::10, 0, :2], axis=0), axis=-1).sum())
        measures = {name: round(value, 2) for name, value in quality([motion]).items()}
        rows.append(
            {
                "text": prompt.text,
                "good": not found and failed is None,
                **found,
                "travelled_m": round(way, 1),
                **measures,
            }
        )
        shown.append((prompt.text, motion))
    counts = {name: sum(name in row for row in rows) for name in ("froze", "drifted", "exploded")}
    good = sum(bool(row["good"]) for row in rows)
    return {
        "rollouts": len(PROMPTS), "seconds": seconds, "good": good, **counts, "ended_early": failed, "rows": rows
    }, shown  # fmt: skip


SWITCHES = {
    "walk": "a person walks forward.",
    "run": "a person runs forward.",
    "turn_left": "a person turns to the left.",
    "turn_right": "a person turns to the right.",
    "wave_left": "a person waves with the left hand.",
    "wave_right": "a person waves with the right hand.",
    "jump": "a person jumps.",
    "stand": "a person stops and stands still.",
    "squat": "a person squats down.",
    "walk_back": "a person walks backwards.",
    "punch_right": "a person punches with the right hand.",
    "kick_left": "a person kicks with the left foot.",
}
"""Text of each kind; a switch goes from one to another."""
BEFORE_S, AFTER_S = 3, 1


def switch_pairs(count: int, seed: int) -> list[tuple[str, str]]:
    """(from, to) kinds: every kind is gone to about as often; what is stopped is a walk or a run."""
    rng = np.random.default_rng(seed)
    out = []
    kinds = list(SWITCHES)
    for number in range(count):
        to = kinds[number % len(kinds)]
        others = ["walk", "run"] if to == "stand" else [kind for kind in kinds if kind != to]
        out.append((str(rng.choice(others)), to))
    return out


def switches(
    planner: Planner, seed: int, count: int = 100, advance: Advance = lambda count: None
) -> tuple[dict[str, object], list[tuple[str, Array]]]:
    """Prompts changed after three seconds: whether the new one's first movement shows within a second.

    Returns:
        {switches, shown, by_kind: {to: {n, shown}}, rows: [{from, to, shown, after_s, ...}]}; also motions to look at.
    """
    pairs = switch_pairs(count, seed)
    start = np.repeat(standing_clip(planner.spec.prefix_frames, FPS).positions_w_m[None], count, 0)
    rollout = Rollout(planner, start, seed)
    for second in range(BEFORE_S + AFTER_S):
        place = int(second >= BEFORE_S)
        rollout.step(lambda body, view: PlanGoal(text=SWITCHES[pairs[body][place]]))  # noqa: B023 - used at once
        advance(count)
    rows: list[dict[str, object]] = []
    shown: list[tuple[str, Array]] = []
    for body, (one, other) in enumerate(pairs):
        motion = rollout.frames(body)
        at = len(motion) - AFTER_S * FPS - 1
        found = first_movement(other, motion[: at + 1], motion[at:], FPS)
        rows.append({"from": one, "to": other, "shown": found.after_s is not None, "after_s": found.after_s,
                     **{name: round(value, 3) for name, value in found.measures.items()}})  # fmt: skip
        shown.append((f"{one} -> {other}", motion[at - FPS :]))
    kinds = {
        kind: {"n": len(these), "shown": sum(bool(row["shown"]) for row in these) / len(these)}
        for kind in SWITCHES
        if (these := [row for row in rows if row["to"] == kind])
    }
    return {
        "switches": count, "shown": sum(bool(row["shown"]) for row in rows) / count, "by_kind": kinds, "rows": rows
    }, shown  # fmt: skip


def _sliding(values: Array, width: int) -> Array:
    """(T - width + 1, width) windows of (T,) values; one of them all where there are fewer."""
    return np.lib.stride_tricks.sliding_window_view(values, min(width, len(values)))


def _still(p: Array) -> float | None:
    """Second at which the first stretch of STILL_S begins in which every joint stays within STILL_M of its mean."""
    width = round(STILL_S * FPS)
    for at in range(0, len(p) - width + 1, FPS // 2):
        part = p[at : at + width]
        if np.linalg.norm(part - part.mean(0), axis=-1).max() < STILL_M:
            return at / FPS
    return None
