"""Made motion on the floor: rises from lying, as lying down told backwards and slower or faster, and lying still."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from shared.data.label import Label
from shared.data.make_gaits import hastened
from shared.data.make_paths import Source
from shared.data.make_steps import swayed
from shared.data.maker import Maker
from shared.data.pieces import Piece
from shared.data.splice import local_rotations, settle, settle_before
from shared.motion.body import Array, J, mirror
from shared.motion.kinematics import forward_kinematics
from shared.motion.skeleton import CANONICAL
from shared.protocol.rates import CORPUS_FPS as FPS

_LYING_M = 0.3
_STANDING_M = 0.85
_STILL_FRAMES = 12


def lying_ends(pieces: Sequence[Piece]) -> list[Source]:
    """Recorded ways from lying up to standing: rises as they are, lying down backwards, and the mirror images."""
    out = []
    for piece in pieces:
        if piece.label.behaviour not in ("lie_down", "get_up"):
            continue
        p = piece.positions if piece.label.behaviour == "get_up" else piece.positions[::-1]
        if p[0, 0, 2] < _LYING_M and p[-1, 0, 2] > _STANDING_M:
            out += [Source(piece.take, piece.source, q) for q in (p, mirror(p))]
    return out


def floor(maker: Maker, known: Sequence[Source], count: int) -> None:
    """Lying still and getting up; one in four only lies."""
    rng = maker.rng
    # Few rises were recorded as rises, and only they begin on the belly.
    face_up = np.array([_chest_up(s.positions[0]) > 0 for s in known])
    share = np.where(face_up, 1.0 / max(face_up.sum(), 1), 0.6 / max((~face_up).sum(), 1))
    for k in range(count):
        source = known[int(rng.choice(len(known), p=share / share.sum()))]
        up = hastened(_from_lying(source.positions), float(rng.uniform(0.85, 1.15)))
        if k % 4 == 3:
            p = lie_still(up[0], int(rng.uniform(3.5, 6.0) * FPS), rng)
            maker.add("lie", Label("lie_down", "lie"), p, source)
            continue
        p = settle_before(up, int(rng.uniform(0.3, 1.5) * FPS), up[0])
        p = settle(p, int(rng.uniform(0.6, 1.2) * FPS))
        maker.add("get_up", Label("get_up", "get_up"), p, source)


def _chest_up(pose: Array) -> float:
    """How far the chest of a pose (22, 3) looks upward, from 1 on the back to -1 on the belly."""
    across = pose[J["left_shoulder"]] - pose[J["right_shoulder"]]
    ahead = np.cross(across, pose[J["neck"]] - pose[J["spine2"]])
    return float(ahead[2] / np.linalg.norm(ahead))


def _from_lying(p: Array) -> Array:
    """A rise without most of the time that it lies still before."""
    moving = np.flatnonzero(np.linalg.norm(p - p[0], axis=-1).max(axis=-1) > 0.06)
    return p[max(int(moving[0]) - _STILL_FRAMES, 0) :] if len(moving) else p


def lie_still(pose: Array, frames: int, rng: np.random.Generator) -> Array:
    """(frames, 22, 3) a body that lies in `pose` (22, 3) and breathes."""
    local = swayed(np.repeat(local_rotations(pose[None]), frames, axis=0), rng, 0.6)
    p, _ = forward_kinematics(CANONICAL, np.repeat(pose[None, 0], frames, axis=0), local)
    return p
