"""From a recorded take to labelled, grounded pieces of motion of usable length."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from shared.data.grounding import Quality, ground, measure
from shared.data.label import (
    Label,
    airborne,
    chunks,
    jump_label,
    locomotion_label,
    rotation_steps_rad,
    segment_locomotion,
    side_of,
    turned_rad,
)
from shared.data.phases import Phase, phases_of
from shared.data.props import Seat, Strike
from shared.data.retarget import Calibration, retarget
from shared.data.sources import Take
from shared.data.splice import denoise, extend_cycle, local_rotations, settle, settle_before
from shared.data.texts import clean, sentences
from shared.motion.body import Array, J, forward_of, heading_rad, origin_start, place, runs, velocity
from shared.motion.io.raw import RawMotion
from shared.protocol.rates import CORPUS_FPS as FPS

SHORTEST = 100
"""Frames of the shortest clip: a planner window of 60 frames at 20 fps takes 90 frames at 30 fps, and some margin."""

LONGEST_S = 8.0
MAX_SPEED_MPS = 15.0
MAX_ACCELERATION_MPS2 = 420.0
MAX_ROTATION_STEP_RAD = 1.6
_FASTEST_TO_REST_MPS = 1.6
_MAX_PENETRATION_MM = 30.0
_MAX_HEIGHT_SPREAD_M = 0.3


@dataclass(frozen=True)
class Piece:
    """A labelled piece of motion: joint positions (T, 22, 3) at 30 fps, on the floor."""

    name: str
    take: str
    source: str
    label: Label
    texts: tuple[str, ...]
    positions: Array
    made: bool = False
    quality: Quality | None = None
    split: str = "train"
    seat: Seat | None = None
    strike: Strike | None = None


def at_origin(piece: Piece) -> Piece:
    """The piece with its props turned and shifted so that its first frame stands over the origin facing +X."""
    p = piece.positions
    yaw = -float(heading_rad(p[:1])[0])
    shift = -place(p[:1], yaw)[0, 0, :2]
    seat = None if piece.seat is None else piece.seat.moved(yaw, shift)
    strike = None if piece.strike is None else piece.strike.moved(yaw, shift)
    return replace(piece, positions=origin_start(p), seat=seat, strike=strike)


@dataclass
class Report:
    """What was left out, and why; which files could not be read; and how a person's own were read, in lines."""

    left_out: list[dict[str, str]] = field(default_factory=list)
    errors: list[dict[str, str]] = field(default_factory=list)
    lines: list[str] = field(default_factory=list)
    files: list[dict[str, Any]] = field(default_factory=list)

    def drop(self, name: str, reason: str) -> None:
        self.left_out.append({"clip": name, "reason": reason})

    def fail(self, name: str, reason: str) -> None:
        """A file that cannot be read: left out too, and an error."""
        self.drop(name, reason)
        self.errors.append({"clip": name, "reason": reason})
        self.lines.append(f"error: {name}: {reason}")


def glitch_free(p: Array, shortest: int = 45) -> list[tuple[int, int]]:
    """Pieces between frames at which a joint jumps faster than a body can: broken frames are cut out."""
    step = np.linalg.norm(np.diff(p, axis=0), axis=-1).max(axis=1) * FPS
    jerk = np.zeros(len(p))
    jerk[1:-1] = np.linalg.norm(p[2:] - 2 * p[1:-1] + p[:-2], axis=-1).max(axis=1) * FPS**2
    bad = np.zeros(len(p), dtype=bool)
    bad[1:] |= step > MAX_SPEED_MPS
    bad[:-1] |= step > MAX_SPEED_MPS
    bad |= jerk > MAX_ACCELERATION_MPS2
    return [(a, b) for a, b in runs(~bad) if b - a >= min(shortest, len(p))]


def lengthen(p: Array, label: Label, low_m: float = 0.7) -> Array | None:
    """At least SHORTEST frames: cycles repeat, other motion begins and ends in a stand, or at rest where the pelvis is
    below `low_m`.

    None for what is too fast at an end to come to rest within half a second.
    """
    missing = SHORTEST - len(p)
    if missing <= 0:
        return p
    if label.behaviour in ("walk", "run", "sneak") and label.action not in ("walk_stop", "walk_start_stop", "steps"):
        # Runs are recorded in cuts of a stride or two.
        longer = extend_cycle(p, SHORTEST, 0.5 if label.behaviour == "run" else 0.22)
        if longer is not None:
            return longer
    if label.action == "hop":
        longer = extend_cycle(p, SHORTEST, 0.36, 2)
        if longer is not None:
            return longer
    n = min(5, len(p) - 1)
    ends_mps = [np.linalg.norm(q[n, 0, :2] - q[0, 0, :2]) * FPS / max(n, 1) for q in (p, p[::-1])]
    if max(ends_mps) > _FASTEST_TO_REST_MPS:
        return None
    low_start, low_end = (p[i, J["pelvis"], 2] < low_m for i in (0, -1))
    before = max(missing // 3, 15)
    after = max(missing - before, 20)
    p = settle(p, after, p[-1] if low_end else None)
    return settle_before(p, before, p[0] if low_start else None)


def _phases(take: Take, p: Array) -> list[Phase]:
    """Pieces of a take and their labels."""
    known = phases_of(take.action, p)
    if known is not None:
        return known
    if take.action == "auto" and take.behaviour in ("walk", "run"):
        cut = segment_locomotion(p, FPS, longest_s=LONGEST_S)
        return [Phase(a, b, locomotion_label(p[a:b])) for a, b in cut]
    cut = chunks(0, len(p), int(LONGEST_S * FPS), int(2 * FPS))
    return [Phase(a, b, _label(take, p[a:b])) for a, b in cut]


def _label(take: Take, piece: Array) -> Label:
    if take.behaviour == "jump" and take.action == "auto":
        return jump_label(piece) if airborne(piece).any() else locomotion_label(piece)
    if take.action == "walk_start_stop":
        return locomotion_label(piece)
    if take.behaviour == "sneak" or take.action == "zombie":
        # A sneaking take also stands and turns; only what moves is sneaking.
        seen = locomotion_label(piece)
        if seen.behaviour in ("stand", "turn"):
            return seen
    side = take.side
    if side == "auto" and take.behaviour == "step_side":
        left = np.array([-1.0, 1.0]) * forward_of(piece)[0, 1::-1]
        side = side_of(float((piece[-1, 0, :2] - piece[0, 0, :2]) @ left))
    elif side == "auto":
        side = jump_label(piece).side or side_of(turned_rad(piece))
    return Label(take.behaviour, take.action, side)


def reason_to_leave_out(p: Array, quality: Quality) -> str:
    """Why a finished clip is not fit for training, or ''."""
    if quality.max_joint_speed_mps > MAX_SPEED_MPS:
        return f"a joint moves at {quality.max_joint_speed_mps:.1f} m/s"
    if quality.max_penetration_mm > _MAX_PENETRATION_MM:
        return f"sinks {quality.max_penetration_mm:.0f} mm into the floor"
    if quality.height_spread_m > _MAX_HEIGHT_SPREAD_M:
        return f"the floor cannot be fixed: heights differ by {quality.height_spread_m:.2f} m"
    step = float(rotation_steps_rad(local_rotations(p)).max())
    if step > MAX_ROTATION_STEP_RAD:
        return f"a joint turns {step:.2f} rad in one tick"
    fastest = float(np.linalg.norm(velocity(velocity(p, FPS), FPS), axis=-1).max())
    if fastest > MAX_ACCELERATION_MPS2:
        return f"a joint accelerates at {fastest:.0f} m/s2"
    return ""


def pieces_of(take: Take, raw: RawMotion, calibration: Calibration, report: Report) -> list[Piece]:
    """Labelled pieces of one take."""
    p = retarget(raw, calibration)
    if len(p) > 2 and np.linalg.norm(p[1] - p[0], axis=-1).max() > 0.25:
        p = p[1:]  # the file's first frame is its zero pose
    whole = glitch_free(p)
    if not whole:
        report.drop(take.name, "broken frames throughout")
        return []
    out: list[Piece] = []
    for k, (first, last) in enumerate(whole):
        grounded, _ = ground(denoise(p[first:last]))
        for phase in _phases(take, grounded):
            a, b, label = phase.start, phase.stop, phase.label
            name = take.name + (f"#{k}" if len(whole) > 1 else "") + (f"@{a}" if b - a < last - first else "")
            longer = lengthen(grounded[a:b], label, 0.7 if phase.seat is None else 0.87)
            if longer is None:
                report.drop(name, "too short, and at speed where it begins or ends")
                continue
            # Whoever sits may have the feet in the air: the height that the whole take stands at is the right one.
            final, quality = ground(longer) if phase.seat is None else (longer, measure(longer, FPS))
            reason = reason_to_leave_out(final, quality)
            if reason:
                report.drop(name, reason)
                continue
            own = take.texts if b - a > 0.6 * len(p) else ()
            texts = tuple(clean([*own, *sentences(label.action, label.side)]))
            piece = Piece(name, take.name, take.source, label, texts, final, False, quality, seat=phase.seat)
            out.append(at_origin(piece))
    return out


def same_recording(f: Array, g: Array) -> bool:
    """Whether two takes are copies of one recording. f, g: (T, 4) bends of knees and elbows in radians.

    Copies have the same length and their middle 60 frames agree within 1.75 degrees; the same person's other walks
    differ by more.
    """
    short, long = (f, g) if len(f) <= len(g) else (g, f)
    n = min(60, len(short))
    if len(long) - len(short) > 3:
        return False
    start = (len(short) - n) // 2
    mid = short[start : start + n]
    if float(np.ptp(mid, axis=0).max()) < np.radians(20):
        return False
    windows = np.lib.stride_tricks.sliding_window_view(long, n, axis=0)  # (W, 4, n)
    return bool(np.abs(windows - mid.T[None]).mean(axis=(1, 2)).min() < np.radians(1.75))
