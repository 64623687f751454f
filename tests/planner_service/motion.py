"""Small procedural motion for tests: a stepping walk on the spot's line, and standing with a waving arm."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from planner_service.builtin.library import save_clip
from shared.motion.ik import clip_from_positions, standing_clip
from shared.motion.limbs import solve_arm, solve_leg
from shared.motion.skeleton import CANONICAL

FPS = 30.0


def walk(seconds: float = 6.0, speed_mps: float = 1.0) -> np.ndarray:
    """(T, 22, 3) walking along +X: feet in arcs, half a cycle apart, the stance foot fixed."""
    t = np.arange(round(seconds * FPS)) / FPS
    p = standing_clip(len(t), FPS).positions_w_m.copy()
    p[..., 2] -= 0.03
    p[..., 0] += (speed_mps * t)[:, None]
    rest = standing_clip(1, FPS).positions_w_m[0]
    cycle_s = 1.0
    for side, shift in (("left", 0.0), ("right", 0.5)):
        phase = (t / cycle_s + shift) % 1.0
        begun = np.floor(t / cycle_s + shift) - shift
        swing = np.clip((phase - 0.5) / 0.5, 0.0, 1.0)
        ease = swing**2 * (3 - 2 * swing)
        x = speed_mps * cycle_s * (begun + 0.25 + ease)
        ankle = np.tile(rest[CANONICAL.index(f"{side}_ankle")], (len(t), 1))
        ankle[:, 0] += x
        ankle[:, 2] += 0.08 * np.sin(np.pi * swing) ** 2
        p = solve_leg(p, side, ankle)
    return clip_from_positions(p, FPS, rebuild=True).positions_w_m


def wave(seconds: float = 4.0) -> np.ndarray:
    """(T, 22, 3) standing, the right hand going up and waving."""
    t = np.arange(round(seconds * FPS)) / FPS
    p = standing_clip(len(t), FPS).positions_w_m.copy()
    shoulder = p[:, CANONICAL.index("right_shoulder")]
    up = np.clip(t / 1.0, 0.0, 1.0)[:, None]
    high = shoulder + np.stack([0.1 + 0 * t, -0.25 + 0.12 * np.sin(2 * np.pi * t), 0.35 + 0 * t], axis=-1)
    p = solve_arm(p, "right", (1 - up) * p[:, CANONICAL.index("right_wrist")] + up * high)
    return clip_from_positions(p, FPS, rebuild=True).positions_w_m


def write_library(folder: Path) -> Path:
    """A clip library of both."""
    for name, texts, positions in (
        ("walk", ["a person walks forward", "someone is walking"], walk()),
        ("wave", ["a person waves with the right hand"], wave()),
    ):
        save_clip(folder, name, texts, positions, FPS)
    return folder
