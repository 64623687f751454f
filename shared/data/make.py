"""Motion that was not recorded, made from what was: each piece inherits the split of the takes it is made from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from shared.data.label import Label, locomotion_label, path_speed, side_of, turned_rad
from shared.data.make_floor import floor, lying_ends
from shared.data.make_gaits import change_gait, curve, gait, hastened, straightened
from shared.data.make_jump import jump_on_spot
from shared.data.make_paths import (
    Source,
    find_starts,
    find_stops,
    find_turns,
    long_walk,
    pick,
    start_walking,
    stop_walking,
    turn_within_walk,
    yaw_pulse,
)
from shared.data.make_stand import idle, quiet_frames, turn_on_spot, wave
from shared.data.make_strikes import blows, strikes
from shared.data.make_tasks import rises, sits, steps, walks_back, walks_to_seats, ways
from shared.data.maker import Maker
from shared.data.pieces import SHORTEST, Piece, Report
from shared.data.splice import rebuild
from shared.motion.body import Array, mirror
from shared.protocol.rates import CORPUS_FPS as FPS

_STRAIGHT = ("walk", "walk_fast", "walk_slow")
_LEAST_RUN_MPS = 1.5
_JOG_MPS = 2.1
"""Slower jogs are hastened toward this, by a quarter at most."""

COUNTS = {
    "idle": 60, "turn": 130, "wave": 100, "walk_wave": 40, "start": 60, "stop": 60, "walk_turn": 60, "run_mix": 120,
    "jump": 60, "step": 210, "walk_back": 50, "sit": 120, "walk_sit": 50, "rise": 130, "strike": 340, "get_up": 120,
}  # fmt: skip
"""Pieces of each kind made for training; the held-out split gets a tenth."""


def bends(maker: Maker) -> None:
    """Every walk and run along curves, both ways, and with sharp bends."""
    for source in [*maker.walks, *maker.jogs]:
        running = source in maker.jogs
        frames = int(maker.rng.uniform(5.5, 7.5) * FPS)
        p = long_walk(source.positions, frames)
        if p is None:
            continue
        for sign in (1.0, -1.0):
            rate = sign * maker.rng.uniform(0.2, 0.62)
            bent = curve(p, rate)
            maker.add("bend", locomotion_label(bent), bent, source)
        sign = 1.0 if maker.chance() else -1.0
        angle = sign * np.radians(maker.rng.uniform(60, 185))
        seconds = abs(angle) / maker.rng.uniform(0.7, 1.0 if running else 1.15)
        start = int(maker.rng.uniform(0.6, 1.4) * FPS)
        bent = curve(p, yaw_pulse(len(p), float(angle), float(seconds), start))
        maker.add("pulse", _turning_label(bent, running), bent, source)
        weave = maker.rng.uniform(0.3, 0.6) * np.sin(np.arange(len(p)) / FPS * maker.rng.uniform(0.8, 1.6))
        bent = curve(p, weave)
        maker.add("weave", locomotion_label(bent), bent, source)


def idles(maker: Maker, count: int) -> None:
    for _ in range(count):
        source, pose = maker.stand_pose()
        frames = int(maker.rng.uniform(4.0, 7.0) * FPS)
        maker.add("idle", Label("stand", "stand"), idle(pose, frames, maker.rng, maker.rng.uniform(0.5, 1.2)), source)


def spins(maker: Maker, count: int) -> None:
    """Stepping round on the spot, from 65 to 200 degrees."""
    for k in range(count):
        source, pose = maker.stand_pose()
        angle = np.radians(maker.rng.uniform(65, 200)) * (1 if k % 2 else -1)
        p = turn_on_spot(pose, float(angle), maker.rng, (maker.rng.uniform(0.4, 1.0), maker.rng.uniform(0.6, 1.5)))
        maker.add("spin", _spin_label(float(angle)), p, source)


def jumps(maker: Maker, count: int) -> None:
    """Jumps on the spot between stands."""
    for _ in range(count):
        source, pose = maker.stand_pose()
        maker.add("jump", Label("jump", "jump"), jump_on_spot(pose, maker.rng), source)


def waves(maker: Maker, count: int, walking: int) -> None:
    for k in range(count):
        source, pose = maker.stand_pose()
        seconds = maker.rng.uniform(4.2, 6.5)
        p = idle(pose, int(seconds * FPS), maker.rng)
        start = -1.0 if maker.rng.random() < 0.2 else maker.rng.uniform(0.2, 0.9)
        stop = seconds + 1 if maker.rng.random() < 0.35 else seconds - maker.rng.uniform(1.0, 1.5)
        side = "left" if k % 2 else "right"
        label = Label("wave", "wave", side)
        if maker.rng.random() < 0.15:
            p = wave(p, "left" if side == "right" else "right", maker.rng, start, stop)
            label = Label("wave", "wave_both", side)
        maker.add("wave", label, wave(p, side, maker.rng, start, stop), source)
    for k in range(walking):
        source = maker.flipped(pick(maker.rng, maker.walks))
        walk = long_walk(source.positions, int(maker.rng.uniform(4.5, 6.0) * FPS))
        if walk is None:
            continue
        walk = curve(walk, maker.rng.uniform(-0.3, 0.3))
        side = "left" if k % 2 else "right"
        p = wave(walk, side, maker.rng, maker.rng.uniform(-0.5, 0.8), len(walk) / FPS - maker.rng.uniform(-0.5, 1.2))
        maker.add("walk_wave", Label("wave", "walk_wave", side), p, source)


def begins(maker: Maker, count: int) -> None:
    """Starts from a stand, preceded by idling."""
    for _ in range(count if maker.starts else 0):
        source, at = maker.starts[int(maker.rng.integers(len(maker.starts)))]
        walk = pick(maker.rng, maker.walks)
        flip = maker.chance()
        a, b = (mirror(s.positions) if flip else s.positions for s in (source, walk))
        cycle = long_walk(b, 170)
        p = None if cycle is None else start_walking(a, at, cycle, 190)
        if p is None or len(p) < 100:
            continue
        label = Label("walk", "walk_start")
        if maker.chance():
            p = curve(p, maker.rng.uniform(-0.5, 0.5))
        if abs(turned_rad(p)) > np.radians(60):
            label = Label("walk", "walk_curve", side_of(turned_rad(p)))
        maker.add("start", label, p, source, walk)


def ends(maker: Maker, count: int) -> None:
    """Stops, followed by a stand, a wave or a turn on the spot."""
    for k in range(count if maker.stops else 0):
        source, at = maker.stops[int(maker.rng.integers(len(maker.stops)))]
        walk = pick(maker.rng, maker.walks)
        flip = maker.chance()
        a, b = (mirror(s.positions) if flip else s.positions for s in (source, walk))
        cycle = long_walk(b, 130)
        if cycle is None:
            continue
        p = stop_walking(curve(cycle, maker.rng.uniform(-0.35, 0.35)), a, at, 40)
        if p is None:
            continue
        p = p[-min(len(p), 170) :]
        label = Label("walk", "walk_stop")
        if k % 3 == 2:
            angle = np.radians(maker.rng.uniform(60, 190)) * (1 if maker.chance() else -1)
            spin = turn_on_spot(p[-1], float(angle), maker.rng, (0.2, 0.8))
            p = np.concatenate([p[-100:], spin])
            label = _spin_label(float(angle))
        maker.add("stop", label, p, source, walk)


def sharp_turns(maker: Maker, count: int) -> None:
    """Recorded sharp turns between two other walks."""
    for _ in range(count if maker.turns else 0):
        source, at = maker.turns[int(maker.rng.integers(len(maker.turns)))]
        first, second = pick(maker.rng, maker.walks), pick(maker.rng, maker.walks)
        flip = maker.chance()
        a, t, b = (mirror(s.positions) if flip else s.positions for s in (first, source, second))
        p = turn_within_walk(a, t, at, b)
        if p is None or len(p) < 100:
            continue
        p = p[:240]
        maker.add("sharp", _turning_label(p, False), p, first, source, second)


def run_mixes(maker: Maker, count: int) -> None:
    """From a stand or a walk into a run and back, over a few steps."""
    kinds = (_run_off, _run_out, _speed_up, _slow_down)
    for k in range(count if maker.jogs and maker.starts and maker.stops else 0):
        jog, walk = pick(maker.rng, maker.jogs), pick(maker.rng, maker.walks)
        kinds[k % len(kinds)](maker, jog, walk, maker.chance(), float(maker.rng.uniform(1.1, 1.9)))


def _run_off(maker: Maker, jog: Source, walk: Source, flip: bool, seconds: float) -> None:
    source, at = maker.starts[int(maker.rng.integers(len(maker.starts)))]
    run, cycle = _steady(maker, jog, flip, 170), _steady(maker, walk, flip, 150)
    a = mirror(source.positions) if flip else source.positions
    p = None if cycle is None else start_walking(a, at, cycle, 190)
    _changed(maker, "run_off", Label("run", "run_start"), p, run, at[1] - at[0], seconds, source, jog, walk)


def _run_out(maker: Maker, jog: Source, walk: Source, flip: bool, seconds: float) -> None:
    source, at = maker.stops[int(maker.rng.integers(len(maker.stops)))]
    run, cycle = _steady(maker, jog, flip, 100), _steady(maker, walk, flip, 150)
    a = mirror(source.positions) if flip else source.positions
    p = None if cycle is None else stop_walking(cycle, a, at, 40, 60)
    _changed(maker, "run_out", Label("run", "run_stop"), run, p, 15, seconds, source, jog, walk)


def _speed_up(maker: Maker, jog: Source, walk: Source, flip: bool, seconds: float) -> None:
    run, cycle = _steady(maker, jog, flip, 170), _steady(maker, walk, flip, 120)
    _changed(maker, "speed_up", Label("run", "run"), cycle, run, 15, seconds, jog, walk)


def _slow_down(maker: Maker, jog: Source, walk: Source, flip: bool, seconds: float) -> None:
    run, cycle = _steady(maker, jog, flip, 100), _steady(maker, walk, flip, 170)
    _changed(maker, "slow_down", Label("walk", "walk"), run, cycle, 15, seconds, jog, walk)


def _steady(maker: Maker, source: Source, flip: bool, frames: int) -> Array | None:
    return long_walk(mirror(source.positions) if flip else source.positions, frames)


def _changed(
    maker: Maker, kind: str, label: Label, a: Array | None, b: Array | None, at: int, seconds: float, *sources: Source
) -> None:
    """Keep `a` that goes over into `b` some time after its frame `at` and its first step."""
    steps = None if a is None else gait(a)
    if a is None or b is None or steps is None:
        return
    first = max(at, int(np.ceil(float(steps.frame_of(steps.first)))))
    p = change_gait(a, first + int(maker.rng.integers(20)), b, seconds)
    if p is not None and len(p) >= SHORTEST:
        maker.add(kind, label, rebuild(p[:220]), *sources)


def _jog(source: Source) -> list[Source]:
    """The recorded run as a straight one at a run's speed; none of those that begin, end or pause."""
    p = straightened(source.positions)
    speed = path_speed(p)[10:-10]  # the smoothed ends show less
    if speed.min() < 0.75 * speed.mean() or speed.mean() < _LEAST_RUN_MPS / 1.25:
        return []
    p = hastened(p, float(np.clip(_JOG_MPS / speed.mean(), 1.0, 1.25)))
    return [Source(source.take, source.source, p)]


def _spin_label(angle_rad: float) -> Label:
    return Label("turn", "turn_around" if abs(angle_rad) > np.radians(140) else "turn", side_of(angle_rad))


def _turning_label(p: Array, running: bool) -> Label:
    turn = turned_rad(p)
    if abs(turn) < np.radians(45):
        return locomotion_label(p)
    if running:
        return Label("run", "run_curve", side_of(turn))
    return Label("turn", "walk_uturn" if abs(turn) > np.radians(135) else "walk_turn", side_of(turn))


def pieces_of_split(pieces: Sequence[Piece], split: str) -> list[Piece]:
    """The pieces on one side of the split."""
    return [p for p in pieces if p.split == split]


def _maker(split: str, pieces: Sequence[Piece], rng: np.random.Generator, report: Report) -> Maker:
    own = pieces_of_split(pieces, split)
    sources = [(p, Source(p.take, p.source, p.positions)) for p in own]
    moving = ("walk", "run", "turn")
    plain = [(p, s) for p, s in sources if p.label.behaviour in moving and p.label.action != "zombie"]
    stands = []
    for _, s in sources:
        quiet = quiet_frames(s.positions)
        if len(quiet):
            stands.append(Source(s.take, s.source, s.positions[quiet[len(quiet) // 2]][None]))
    walking = [s for p, s in plain if p.label.behaviour in ("walk", "turn")]
    return Maker(
        split,
        rng,
        report,
        [s for p, s in plain if p.label.action in _STRAIGHT],
        [jog for p, s in plain if p.label.behaviour == "run" for jog in _jog(s)],
        [(s, at) for s in walking for at in find_starts(s.positions)],
        [(s, at) for s in walking for at in find_stops(s.positions)],
        [(s, at) for s in walking for at in find_turns(s.positions)],
        stands,
    )


def made_pieces(
    pieces: Sequence[Piece],
    rng: np.random.Generator,
    report: Report,
    progress: Callable[[str, float], None],
    amount: float = 1.0,
) -> list[Piece]:
    """Made motion of both splits, each from its own recordings only; `amount` scales how much."""
    out: list[Piece] = []
    for split, share in (("train", amount), ("heldout", 0.1 * amount)):
        maker = _maker(split, pieces, rng, report)
        n = {k: max(1, round(c * share)) for k, c in COUNTS.items()}
        down, up = ways(pieces_of_split(pieces, split), "sit"), ways(pieces_of_split(pieces, split), "rise")
        hits, lying = blows(pieces_of_split(pieces, split)), lying_ends(pieces_of_split(pieces, split))
        stages: list[tuple[str, bool, Callable[[], None]]] = [
            ("bent paths", bool(maker.walks), partial(bends, maker)),
            ("starts", bool(maker.walks), partial(begins, maker, n["start"])),
            ("stops", bool(maker.walks), partial(ends, maker, n["stop"])),
            ("sharp turns", bool(maker.walks), partial(sharp_turns, maker, n["walk_turn"])),
            ("runs", bool(maker.walks), partial(run_mixes, maker, n["run_mix"])),
            ("idling", bool(maker.stands), partial(idles, maker, n["idle"])),
            ("turns on the spot", bool(maker.stands), partial(spins, maker, n["turn"])),
            ("jumps", bool(maker.stands), partial(jumps, maker, n["jump"])),
            ("walks backward", bool(maker.walks), partial(walks_back, maker, n["walk_back"])),
            ("steps", bool(maker.stands), partial(steps, maker, n["step"])),
            ("waves", bool(maker.stands and maker.walks), partial(waves, maker, n["wave"], n["walk_wave"])),
            ("strikes", bool(maker.stands and hits), partial(strikes, maker, hits, n["strike"])),
            ("getting up", bool(lying), partial(floor, maker, lying, n["get_up"])),
            ("sits", bool(maker.stands and down), partial(sits, maker, down, n["sit"])),
            ("walks to seats", bool(down), partial(walks_to_seats, maker, down, n["walk_sit"])),
            ("rises", bool(maker.stands and up), partial(rises, maker, up, n["rise"])),
        ]
        stages = [stage for stage in stages if stage[1]]
        first, span = (0.6, 0.3) if split == "train" else (0.9, 0.05)
        for k, (name, _, stage) in enumerate(stages):
            progress(f"make {name} ({split})", first + span * k / len(stages))
            stage()
        out += maker.out
    return out
