"""Motion that was not recorded, made from what was: each piece inherits the split of the takes it is made from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from shared.data.grounding import ground
from shared.data.label import Label, locomotion_label, path_speed, side_of, turned_rad
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
from shared.data.pieces import SHORTEST, Piece, Report, reason_to_leave_out
from shared.data.splice import rebuild, settle, stand_over_feet
from shared.data.texts import clean, sentences
from shared.motion.body import Array, mirror, origin_start

FPS = 30.0
_STRAIGHT = ("walk", "walk_fast", "walk_slow")
_LEAST_RUN_MPS = 1.5
_JOG_MPS = 2.1
"""Slower jogs are hastened toward this, by a quarter at most."""

COUNTS = {
    "idle": 60, "turn": 130, "wave": 100, "walk_wave": 40, "start": 60, "stop": 60, "walk_turn": 60, "run_mix": 120,
    "jump": 60,
}  # fmt: skip
"""Pieces of each kind made for training; the held-out split gets a tenth."""


@dataclass
class Maker:
    """Makes pieces of one split from that split's recordings."""

    split: str
    rng: np.random.Generator
    report: Report
    walks: list[Source]
    jogs: list[Source]
    starts: list[tuple[Source, tuple[int, int]]]
    stops: list[tuple[Source, tuple[int, int]]]
    turns: list[tuple[Source, tuple[int, int]]]
    stands: list[Source]
    out: list[Piece] = field(default_factory=list)

    def add(self, kind: str, label: Label, p: Array, *sources: Source) -> None:
        """Ground a made motion, check it and keep it."""
        if len(p) < SHORTEST:
            p = settle(p, SHORTEST - len(p), p[-1])
        final, quality = ground(p)
        takes = "+".join(dict.fromkeys(s.take for s in sources))
        name = f"made/{self.split}/{kind}/{len(self.out):04d}"
        reason = reason_to_leave_out(final, quality)
        if reason:
            self.report.drop(f"{name} from {takes}", reason)
            return
        texts = tuple(clean(sentences(label.action, label.side)))
        archives = "+".join(sorted({s.source for s in sources}))
        self.out.append(Piece(name, takes, archives, label, texts, origin_start(final), True, quality, self.split))

    def chance(self) -> bool:
        return bool(self.rng.random() < 0.5)

    def flipped(self, source: Source) -> Source:
        """The source or its mirror image, evenly."""
        return source if self.chance() else Source(source.take, source.source, mirror(source.positions))

    def stand_pose(self) -> tuple[Source, Array]:
        """A recorded quiet pose; one in three with the relaxed arms of the standard stand."""
        source = self.flipped(pick(self.rng, self.stands))
        pose = source.positions[0]
        return source, stand_over_feet(pose) if self.rng.random() < 0.33 else pose

    def bends(self) -> None:
        """Every walk and run along curves, both ways, and with sharp bends."""
        for source in [*self.walks, *self.jogs]:
            running = source in self.jogs
            frames = int(self.rng.uniform(5.5, 7.5) * FPS)
            p = long_walk(source.positions, frames)
            if p is None:
                continue
            for sign in (1.0, -1.0):
                rate = sign * self.rng.uniform(0.2, 0.62)
                bent = curve(p, rate)
                self.add("bend", locomotion_label(bent), bent, source)
            sign = 1.0 if self.chance() else -1.0
            angle = sign * np.radians(self.rng.uniform(60, 185))
            seconds = abs(angle) / self.rng.uniform(0.7, 1.0 if running else 1.15)
            start = int(self.rng.uniform(0.6, 1.4) * FPS)
            bent = curve(p, yaw_pulse(len(p), float(angle), float(seconds), start))
            self.add("pulse", _turning_label(bent, running), bent, source)
            weave = self.rng.uniform(0.3, 0.6) * np.sin(np.arange(len(p)) / FPS * self.rng.uniform(0.8, 1.6))
            bent = curve(p, weave)
            self.add("weave", locomotion_label(bent), bent, source)

    def idles(self, count: int) -> None:
        for _ in range(count):
            source, pose = self.stand_pose()
            frames = int(self.rng.uniform(4.0, 7.0) * FPS)
            self.add("idle", Label("stand", "stand"), idle(pose, frames, self.rng, self.rng.uniform(0.5, 1.2)), source)

    def spins(self, count: int) -> None:
        """Stepping round on the spot, from 65 to 200 degrees."""
        for k in range(count):
            source, pose = self.stand_pose()
            angle = np.radians(self.rng.uniform(65, 200)) * (1 if k % 2 else -1)
            p = turn_on_spot(pose, float(angle), self.rng, (self.rng.uniform(0.4, 1.0), self.rng.uniform(0.6, 1.5)))
            self.add("spin", _spin_label(float(angle)), p, source)

    def jumps(self, count: int) -> None:
        """Jumps on the spot between stands."""
        for _ in range(count):
            source, pose = self.stand_pose()
            self.add("jump", Label("jump", "jump"), jump_on_spot(pose, self.rng), source)

    def waves(self, count: int, walking: int) -> None:
        for k in range(count):
            source, pose = self.stand_pose()
            seconds = self.rng.uniform(4.2, 6.5)
            p = idle(pose, int(seconds * FPS), self.rng)
            start = -1.0 if self.rng.random() < 0.2 else self.rng.uniform(0.2, 0.9)
            stop = seconds + 1 if self.rng.random() < 0.35 else seconds - self.rng.uniform(1.0, 1.5)
            side = "left" if k % 2 else "right"
            label = Label("wave", "wave", side)
            if self.rng.random() < 0.15:
                p = wave(p, "left" if side == "right" else "right", self.rng, start, stop)
                label = Label("wave", "wave_both", side)
            self.add("wave", label, wave(p, side, self.rng, start, stop), source)
        for k in range(walking):
            source = self.flipped(pick(self.rng, self.walks))
            walk = long_walk(source.positions, int(self.rng.uniform(4.5, 6.0) * FPS))
            if walk is None:
                continue
            walk = curve(walk, self.rng.uniform(-0.3, 0.3))
            side = "left" if k % 2 else "right"
            p = wave(walk, side, self.rng, self.rng.uniform(-0.5, 0.8), len(walk) / FPS - self.rng.uniform(-0.5, 1.2))
            self.add("walk_wave", Label("wave", "walk_wave", side), p, source)

    def begins(self, count: int) -> None:
        """Starts from a stand, preceded by idling."""
        for _ in range(count if self.starts else 0):
            source, at = self.starts[int(self.rng.integers(len(self.starts)))]
            walk = pick(self.rng, self.walks)
            flip = self.chance()
            a, b = (mirror(s.positions) if flip else s.positions for s in (source, walk))
            cycle = long_walk(b, 170)
            p = None if cycle is None else start_walking(a, at, cycle, 190)
            if p is None or len(p) < 100:
                continue
            label = Label("walk", "walk_start")
            if self.chance():
                p = curve(p, self.rng.uniform(-0.5, 0.5))
            if abs(turned_rad(p)) > np.radians(60):
                label = Label("walk", "walk_curve", side_of(turned_rad(p)))
            self.add("start", label, p, source, walk)

    def ends(self, count: int) -> None:
        """Stops, followed by a stand, a wave or a turn on the spot."""
        for k in range(count if self.stops else 0):
            source, at = self.stops[int(self.rng.integers(len(self.stops)))]
            walk = pick(self.rng, self.walks)
            flip = self.chance()
            a, b = (mirror(s.positions) if flip else s.positions for s in (source, walk))
            cycle = long_walk(b, 130)
            if cycle is None:
                continue
            p = stop_walking(curve(cycle, self.rng.uniform(-0.35, 0.35)), a, at, 40)
            if p is None:
                continue
            p = p[-min(len(p), 170) :]
            label = Label("walk", "walk_stop")
            if k % 3 == 2:
                angle = np.radians(self.rng.uniform(60, 190)) * (1 if self.chance() else -1)
                spin = turn_on_spot(p[-1], float(angle), self.rng, (0.2, 0.8))
                p = np.concatenate([p[-100:], spin])
                label = _spin_label(float(angle))
            self.add("stop", label, p, source, walk)

    def sharp_turns(self, count: int) -> None:
        """Recorded sharp turns between two other walks."""
        for _ in range(count if self.turns else 0):
            source, at = self.turns[int(self.rng.integers(len(self.turns)))]
            first, second = pick(self.rng, self.walks), pick(self.rng, self.walks)
            flip = self.chance()
            a, t, b = (mirror(s.positions) if flip else s.positions for s in (first, source, second))
            p = turn_within_walk(a, t, at, b)
            if p is None or len(p) < 100:
                continue
            p = p[:240]
            self.add("sharp", _turning_label(p, False), p, first, source, second)

    def run_mixes(self, count: int) -> None:
        """From a stand or a walk into a run and back, over a few steps."""
        kinds = (self._run_off, self._run_out, self._speed_up, self._slow_down)
        for k in range(count if self.jogs and self.starts and self.stops else 0):
            jog, walk = pick(self.rng, self.jogs), pick(self.rng, self.walks)
            kinds[k % len(kinds)](jog, walk, self.chance(), float(self.rng.uniform(1.1, 1.9)))

    def _run_off(self, jog: Source, walk: Source, flip: bool, seconds: float) -> None:
        source, at = self.starts[int(self.rng.integers(len(self.starts)))]
        run, cycle = self._steady(jog, flip, 170), self._steady(walk, flip, 150)
        a = mirror(source.positions) if flip else source.positions
        p = None if cycle is None else start_walking(a, at, cycle, 190)
        self._changed("run_off", Label("run", "run_start"), p, run, at[1] - at[0], seconds, source, jog, walk)

    def _run_out(self, jog: Source, walk: Source, flip: bool, seconds: float) -> None:
        source, at = self.stops[int(self.rng.integers(len(self.stops)))]
        run, cycle = self._steady(jog, flip, 100), self._steady(walk, flip, 150)
        a = mirror(source.positions) if flip else source.positions
        p = None if cycle is None else stop_walking(cycle, a, at, 40, 60)
        self._changed("run_out", Label("run", "run_stop"), run, p, 15, seconds, source, jog, walk)

    def _speed_up(self, jog: Source, walk: Source, flip: bool, seconds: float) -> None:
        run, cycle = self._steady(jog, flip, 170), self._steady(walk, flip, 120)
        self._changed("speed_up", Label("run", "run"), cycle, run, 15, seconds, jog, walk)

    def _slow_down(self, jog: Source, walk: Source, flip: bool, seconds: float) -> None:
        run, cycle = self._steady(jog, flip, 100), self._steady(walk, flip, 170)
        self._changed("slow_down", Label("walk", "walk"), run, cycle, 15, seconds, jog, walk)

    def _steady(self, source: Source, flip: bool, frames: int) -> Array | None:
        return long_walk(mirror(source.positions) if flip else source.positions, frames)

    def _changed(
        self, kind: str, label: Label, a: Array | None, b: Array | None, at: int, seconds: float, *sources: Source
    ) -> None:
        """Keep `a` that goes over into `b` some time after its frame `at` and its first step."""
        steps = None if a is None else gait(a)
        if a is None or b is None or steps is None:
            return
        first = max(at, int(np.ceil(float(steps.frame_of(steps.first)))))
        p = change_gait(a, first + int(self.rng.integers(20)), b, seconds)
        if p is not None and len(p) >= SHORTEST:
            self.add(kind, label, rebuild(p[:220]), *sources)


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


def _maker(split: str, pieces: Sequence[Piece], rng: np.random.Generator, report: Report) -> Maker:
    own = [p for p in pieces if p.split == split]
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
        stages: list[tuple[str, Callable[[], None]]] = []
        if maker.walks:
            stages += [
                ("bent paths", maker.bends),
                ("starts", partial(maker.begins, n["start"])),
                ("stops", partial(maker.ends, n["stop"])),
                ("sharp turns", partial(maker.sharp_turns, n["walk_turn"])),
                ("runs", partial(maker.run_mixes, n["run_mix"])),
            ]
        if maker.stands:
            stages += [
                ("idling", partial(maker.idles, n["idle"])),
                ("turns on the spot", partial(maker.spins, n["turn"])),
                ("jumps", partial(maker.jumps, n["jump"])),
            ]
        if maker.stands and maker.walks:
            stages.append(("waves", partial(maker.waves, n["wave"], n["walk_wave"])))
        first, span = (0.6, 0.3) if split == "train" else (0.9, 0.05)
        for k, (name, stage) in enumerate(stages):
            progress(f"make {name} ({split})", first + span * k / len(stages))
            stage()
        out += maker.out
    return out
