"""Reference motion prepared for training: every clip's poses, velocities and hinge angles, as flat arrays."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, fields, replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import numpy.typing as npt

from shared.data.corpus import ClipInfo
from shared.errors import InvalidInputError
from shared.motion.characters import build
from shared.protocol.rates import TICK_HZ
from tracker_service.simulation.humanoid import Humanoid
from tracker_service.simulation.kinematics import BodyKinematics, qvel_from_qpos
from tracker_service.simulation.reference import central_velocity, reference_ticks
from tracker_service.training.bags import NO_BAG, Bag, lean_of
from tracker_service.training.seats import NO_SEAT, Seat, lowered, training_model

F32 = npt.NDArray[np.float32]
PLAN = "plan"
"""Behaviour of recorded plans."""
PIECE_TICKS, PIECE_OVERLAP_TICKS, LEAST_PIECE_TICKS = 180, 60, 30
JUMP_M = 0.045
"""Change of the pelvis' step from one tick to the next: 40 m/s2, more than runs and jumps have."""
JOB_CLIPS = 50
LARGEST_CHANGE_RAD = 1.0
"""Arms circled backward and deep squats pass a pole of the shoulder's or hip's three hinges, where the angles jump."""
PREPARATION = "8"
"""Changes whenever prepared arrays would come out differently; part of the cache's key."""


@dataclass(frozen=True)
class MotionInput:
    """A clip to prepare: its name, behaviour, sampling weight and joint positions (T, 22, 3) at 30 Hz, and the seat and
    the bag in it, as `training.seats.NO_SEAT` and `training.bags.NO_BAG` have them."""

    name: str
    behaviour: str
    weight: float
    positions_w_m: npt.NDArray[np.floating]
    seat: Seat = NO_SEAT
    bag: Bag = NO_BAG


@dataclass(frozen=True)
class ReferenceSet:
    """N ticks of C clips. J bodies, H hinges.

    Attributes:
        pos_w_m, linvel_w_mps: (N, J, 3). rot_xy: (N, J, 2, 3) the first two columns of each body's world rotation.
        qpos: (N, 7+H). qvel: (N, 6+H).
        start, length: (C,) first tick and number of ticks of each clip. weight: (C,) for sampling.
        names, behaviours: (C,) of each clip. seat: (C, 5) as `training.seats.NO_SEAT`, which is where none is.
        bag: (C, 5) at each clip's start, as `training.bags.NO_BAG`, which is where none is.
    """

    pos_w_m: F32
    linvel_w_mps: F32
    rot_xy: F32
    qpos: F32
    qvel: F32
    start: npt.NDArray[np.int64]
    length: npt.NDArray[np.int64]
    weight: npt.NDArray[np.float64]
    names: npt.NDArray[np.str_]
    behaviours: npt.NDArray[np.str_]
    seat: npt.NDArray[np.float64]
    bag: npt.NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.start)


def seat_in(clip: ClipInfo) -> Seat:
    """The seat in a clip, a stool; out of the way where there is none."""
    seat = getattr(clip, "seat", None)
    return NO_SEAT if seat is None else (*seat.top_m, seat.heading_rad, 0.0)


def sized(motion: MotionInput, human: Humanoid) -> MotionInput:
    """A motion of the canonical skeleton as a character has it, seat, bag and all; for `human` it stays as it is."""
    own = build(human.character.name)
    if own.world_scale == 1.0:
        return motion
    x, y, z = (float(v) for v in own.from_canonical(motion.seat[:3]))
    seat = motion.seat if motion.seat == NO_SEAT else (x, y, z, *motion.seat[3:])
    bx, by, _ = (float(v) for v in own.from_canonical(motion.bag[:3]))
    bag = motion.bag if motion.bag == NO_BAG else (bx, by, *motion.bag[2:])
    return replace(motion, positions_w_m=own.from_canonical(motion.positions_w_m), seat=seat, bag=bag)


def smooth_stretches(root_w_m: npt.NDArray[np.floating]) -> list[tuple[int, int]]:
    """First tick and tick after the last of the stretches in which a root (T, 3) at 30 Hz never jumps."""
    bend = np.linalg.norm(np.diff(root_w_m, n=2, axis=0), axis=-1)
    jumps = np.flatnonzero(bend > JUMP_M) + 1
    edges = [0, *(int(tick) for jump in jumps for tick in (jump - 1, jump + 2)), len(root_w_m)]
    pairs = zip(edges[::2], edges[1::2], strict=True)
    return [(first, last) for first, last in pairs if last - first >= LEAST_PIECE_TICKS]


def load_bank(folder: Path) -> list[MotionInput]:
    """Pieces of a bank, all of one weight: plans made by `motionloop data bank`, or clips that name their `behaviour`
    (`training.falls`).

    Plans are cut to a few seconds, overlapping, so that failing is noted, and practised, where it happens. They are
    also cut where the pelvis jumps: there the next plan went on from where the body really was, and a body that
    followed so far cannot follow on. A plan made beside a bag is a piece of its own, bag and all.

    Raises:
        InvalidInputError: no piece in the folder.
    """
    motions = []
    for path in sorted(folder.glob("*.npz")):
        with np.load(path, allow_pickle=False) as data:
            whole = data["positions_w_m"]
            behaviour = str(data["behaviour"]) if "behaviour" in data else PLAN
            x, y, top, heading, sofa = (float(v) for v in data["seat"]) if "seat" in data else NO_SEAT
            bag = data.get("bag")
        if bag is not None:
            (bx, by), (about_x, about_y) = (float(v) for v in bag[:2]), (float(v) for v in lean_of(bag[2:]))
            motions.append(MotionInput(path.stem, PLAN, 1.0, whole, bag=(bx, by, 0.0, about_x, about_y)))
            continue
        if behaviour != PLAN:
            motions.append(MotionInput(path.stem, behaviour, 1.0, whole))
            continue
        for first, last in smooth_stretches(whole[:, 0]):
            end = max(last - PIECE_TICKS // 2, first + 1)
            for begin in range(first, end, PIECE_TICKS - PIECE_OVERLAP_TICKS):
                cut = whole[begin : min(begin + PIECE_TICKS, last)]
                motions.append(MotionInput(f"{path.stem}@{begin}", PLAN, 1.0, cut, (x, y, top, heading, sofa)))
    if not motions:
        raise InvalidInputError(f"no pieces in {folder}", field="bank", allowed="a folder of `motionloop data bank`")
    return motions


def concatenated(first: ReferenceSet, second: ReferenceSet, second_share: float) -> ReferenceSet:
    """Both sets as one; the second gets `second_share` of the sampling weight, its clips by their length."""
    a = first.weight / first.weight.sum() * (1.0 - second_share)
    b = second.length / second.length.sum() * second_share
    joined = {
        field.name: np.concatenate([getattr(first, field.name), getattr(second, field.name)])
        for field in fields(ReferenceSet)
    }
    return ReferenceSet(
        **{**joined, "weight": np.concatenate([a, b]), "start": np.append(first.start, second.start + len(first.qpos))}
    )


def largest_change_rad(references: ReferenceSet) -> npt.NDArray[np.float64]:
    """(C,) the most that any hinge of each clip changes in one tick: above a radian the angles jump, not the body."""
    change = np.zeros(len(references.qpos))
    change[1:] = np.abs(np.diff(references.qpos[:, 7:], axis=0)).max(axis=1)
    change[references.start] = 0.0
    return np.maximum.reduceat(change, references.start)


def hinges_jump(references: ReferenceSet) -> npt.NDArray[np.bool_]:
    """(C,) clips that no servo can follow, however well it is done: their hinge angles jump."""
    return largest_change_rad(references) > LARGEST_CHANGE_RAD


def prepare(
    human: Humanoid, motions: Sequence[MotionInput], progress: Callable[[str, float], None] | None = None,
    jobs: int = 1,
) -> ReferenceSet:  # fmt: skip
    """Inverse kinematics, hinges and velocities of all clips; `progress(what, share)` is called now and then.

    Args:
        jobs: processes among which clips are spread; what comes out is the same.
    """
    if jobs == 1 or len(motions) < 2 * JOB_CLIPS:
        return _prepared(human, motions, progress)
    parts = []
    shares = [motions[first : first + JOB_CLIPS] for first in range(0, len(motions), JOB_CLIPS)]
    # Fresh processes: a copy of this one would hold locks of threads that it does not have.
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        for number, part in enumerate(pool.map(_prepared, [human] * len(shares), shares)):
            parts.append(part)
            if progress is not None:
                progress("preparing references", (number + 1) / len(shares))
    names = [field.name for field in fields(ReferenceSet) if field.name != "start"]
    joined = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    return ReferenceSet(**joined, start=np.concatenate([[0], np.cumsum(joined["length"])[:-1]]).astype(np.int64))


def _prepared(
    human: Humanoid, motions: Sequence[MotionInput], progress: Callable[[str, float], None] | None = None
) -> ReferenceSet:
    kinematics = BodyKinematics(human)
    model = training_model(human)
    seats: list[Seat] = []
    parts: dict[str, list[F32]] = {"pos_w_m": [], "linvel_w_mps": [], "rot_xy": [], "qpos": [], "qvel": []}
    for number, motion in enumerate(motions):
        ticks = reference_ticks(human, kinematics, motion.positions_w_m)
        # A plan on a real seat is practised on that seat; what was recorded or made has none but this one.
        known = motion.seat[2] <= 0 or motion.behaviour == PLAN
        seats.append(motion.seat if known else lowered(model, ticks.qpos, motion.seat))
        qvel = qvel_from_qpos(ticks.qpos, TICK_HZ)
        states = kinematics.states(ticks.qpos, qvel)
        parts["pos_w_m"].append(ticks.pos_w_m.astype(np.float32))
        parts["linvel_w_mps"].append(central_velocity(ticks.pos_w_m, TICK_HZ).astype(np.float32))
        parts["rot_xy"].append(np.ascontiguousarray(states.rot_w[..., :2].swapaxes(-1, -2)).astype(np.float32))
        parts["qpos"].append(ticks.qpos.astype(np.float32))
        parts["qvel"].append(qvel.astype(np.float32))
        if progress is not None and number % 50 == 0:
            progress("preparing references", number / len(motions))
    lengths = np.array([len(m.positions_w_m) for m in motions], dtype=np.int64)
    return ReferenceSet(
        **{name: np.concatenate(arrays) for name, arrays in parts.items()},
        start=np.concatenate([[0], np.cumsum(lengths)[:-1]]).astype(np.int64),
        length=lengths,
        weight=np.array([m.weight for m in motions], dtype=np.float64),
        names=np.array([m.name for m in motions], dtype=np.str_),
        behaviours=np.array([m.behaviour for m in motions], dtype=np.str_),
        seat=np.array(seats, dtype=np.float64).reshape(-1, 5),
        bag=np.array([m.bag for m in motions], dtype=np.float64).reshape(-1, 5),
    )


def prepare_cached(
    human: Humanoid,
    motions: Sequence[MotionInput],
    folder: Path,
    progress: Callable[[str, float], None] | None = None,
    jobs: int = 1,
) -> ReferenceSet:
    """As `prepare`, kept in `folder` under a hash of the motions and the character."""
    digest = hashlib.sha256((PREPARATION + human.character.model_dump_json()).encode())
    for motion in motions:
        digest.update(f"{motion.name}|{motion.behaviour}|{motion.weight}|{motion.seat}|{motion.bag}".encode())
        digest.update(np.ascontiguousarray(motion.positions_w_m, dtype=np.float32).tobytes())
    path = folder / f"references_{digest.hexdigest()[:16]}.npz"
    if path.exists():
        with np.load(path, allow_pickle=False) as data:
            return ReferenceSet(**{field.name: data[field.name] for field in fields(ReferenceSet)})
    made = prepare(human, motions, progress, jobs)
    folder.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".tmp.npz")
    np.savez(partial, **{field.name: getattr(made, field.name) for field in fields(ReferenceSet)})
    partial.replace(path)
    return made
