"""Made motion that tasks ask for: sits and rises on seats, steps to all sides; each from one split's recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from shared.data.label import Label, path_speed
from shared.data.make_gaits import curve, hastened
from shared.data.make_paths import Source, long_walk, pick, stop_walking
from shared.data.make_seats import (
    HIGHEST_M,
    LOWEST_M,
    Descent,
    back_up_and_sit,
    descents,
    joined,
    pick_descent,
    sit_down,
    stand_up,
    stay_seated,
)
from shared.data.make_stand import turn_on_spot
from shared.data.make_steps import flat_footed, moved, step_to
from shared.data.maker import Maker
from shared.data.pieces import Piece
from shared.motion.body import Array, J, mirror
from shared.protocol.rates import CORPUS_FPS as FPS

_CALM_MPS, _CALM_M = 1.25, 0.66
"""Speed and distance between the ankles of walks that look right backward."""


@dataclass(frozen=True)
class Way:
    """A recorded way onto or off a seat and the take it comes from."""

    source: Source
    how: Descent


def ways(pieces: Sequence[Piece], behaviour: str) -> list[Way]:
    """What recorded sits or rises and their mirror images teach."""
    out = []
    for p in pieces:
        if p.label.behaviour == behaviour and p.seat is not None and p.label.action != "seated":
            for positions in (p.positions, mirror(p.positions)):
                source = Source(p.take, p.source, positions)
                out += [Way(source, how) for how in descents(positions, behaviour == "rise")]
    return out


def _choose(rng: np.random.Generator, known: Sequence[Way], height_m: float) -> Way:
    how = pick_descent(rng, [w.how for w in known], height_m)
    return next(w for w in known if w.how is how)


def sits(maker: Maker, known: Sequence[Way], count: int) -> None:
    """Sitting down from a stand before the seat, after a step or two back to it, and staying seated."""
    rng = maker.rng
    for k in range(count):
        height = float(rng.uniform(LOWEST_M, HIGHEST_M))
        source, pose = maker.stand_pose()
        way = _choose(rng, known, height)
        if k % 3 == 2:
            p, seat = back_up_and_sit(pose, height, way.how, rng, float(rng.uniform(0.15, 0.55)), rng.uniform(0.8, 1.6))
            label = Label("sit", "back_sit")
        else:
            p, seat = sit_down(pose, height, way.how, rng, rng.uniform(0.3, 1.3), rng.uniform(1.0, 2.2))
            label = Label("sit", "sit_down")
        if k % 4 == 1:
            longer = stay_seated(p, int(rng.uniform(3.5, 5.0) * FPS), rng)
            maker.add("seated", Label("sit", "seated"), longer, source, way.source, seat=seat)
        maker.add("sit", label, p, source, way.source, seat=seat)


def walks_to_seats(maker: Maker, known: Sequence[Way], count: int) -> None:
    """Walking up, stopping, turning round and sitting down."""
    rng = maker.rng
    for _ in range(count if maker.stops and maker.walks else 0):
        stop, at = maker.stops[int(rng.integers(len(maker.stops)))]
        walk = pick(rng, maker.walks)
        cycle = long_walk(walk.positions, 110)
        came = None if cycle is None else stop_walking(cycle, stop.positions, at, 12)
        if came is None:
            continue
        angle = float(np.radians(rng.uniform(120, 190))) * (1 if maker.chance() else -1)
        turned = turn_on_spot(came[-1], angle, rng, (0.1, 0.3))
        height = float(rng.uniform(LOWEST_M, HIGHEST_M))
        way = _choose(rng, known, height)
        back = float(rng.uniform(0.05, 0.35))
        if back < 0.12:
            sat, seat = sit_down(turned[-1], height, way.how, rng, 0.2, rng.uniform(1.0, 1.8))
        else:
            sat, seat = back_up_and_sit(turned[-1], height, way.how, rng, back, rng.uniform(1.0, 1.8))
        p = joined(joined(came[-80:], turned), sat)
        maker.add("walk_sit", Label("sit", "walk_sit"), p, walk, stop, way.source, seat=seat)


def rises(maker: Maker, known: Sequence[Way], count: int) -> None:
    """Getting up from a seat into a stand."""
    rng = maker.rng
    for _ in range(count):
        height = float(rng.uniform(LOWEST_M, HIGHEST_M))
        source, pose = maker.stand_pose()
        way = _choose(rng, known, height)
        p, seat = stand_up(pose, height, way.how, rng, rng.uniform(0.8, 1.8), rng.uniform(0.8, 1.5))
        maker.add("rise", Label("rise", "rise"), p, source, way.source, seat=seat)


def steps(maker: Maker, count: int) -> None:
    """Single steps and several, back, to the sides and forward, and the stand after them."""
    rng = maker.rng
    kinds = (("step_back", "step_back", -1, 0), ("step_side", "step_side", 0, 1), ("step_side", "step_side", 0, -1),
             ("step_back", "walk_back", -1, 0), ("step_side", "walk_side", 0, 1), ("step_side", "walk_side", 0, -1),
             ("walk", "step_forward", 1, 0))  # fmt: skip
    for k in range(count):
        behaviour, action, ahead, left = kinds[k % len(kinds)]
        source, pose = maker.stand_pose()
        pose = flat_footed(pose)
        side = "left" if left > 0 else "right" if left < 0 else ""
        period = float(rng.uniform(0.36, 0.55))
        if action.startswith("step"):
            far = rng.uniform(0.18, 0.42)
            there = flat_footed(moved(pose, ahead * far, left * far))
            p = step_to(pose, there, rng, (rng.uniform(0.4, 1.2), rng.uniform(1.2, 2.2)), period)
        else:
            far = rng.uniform(0.9, 2.2) * (0.8 if left else 1.0)
            there = flat_footed(moved(pose, ahead * far, left * far))
            p = step_to(pose, there, rng, (rng.uniform(0.1, 0.6), rng.uniform(0.2, 0.8)), period)
        maker.add(action, Label(behaviour, action, side), p, source)


def _stride_m(p: Array) -> float:
    return float(np.linalg.norm(p[:, J["left_ankle"], :2] - p[:, J["right_ankle"], :2], axis=-1).max())


def walks_back(maker: Maker, count: int) -> None:
    """Slow walks told backwards: the ball of the foot lands first and the heel leaves last, as in walking backward."""
    rng = maker.rng
    calm = [s for s in maker.walks if path_speed(s.positions).mean() < _CALM_MPS and _stride_m(s.positions) < _CALM_M]
    for _ in range(count if calm else 0):
        source = maker.flipped(pick(rng, calm))
        walk = long_walk(source.positions, 220)
        if walk is None:
            continue
        speed = float(path_speed(walk).mean())
        slower = hastened(walk, float(np.clip(rng.uniform(0.45, 0.85) / speed, 0.45, 0.9)))
        p = curve(slower[::-1][: int(rng.uniform(4.0, 6.5) * FPS)], float(rng.uniform(-0.15, 0.15)))
        maker.add("walk_back", Label("step_back", "walk_back"), p, source)
