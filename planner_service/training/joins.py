"""Switches: the start of one clip joined to another at their nearest poses (DESIGN 9).

Text is obeyed after a switch only if training has shown switches. The difference in pose and speed at the joint fades
out over the frames that follow, so that nothing jumps.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from planner_service.training.windows import Features, ik_6d, rotations_of, window_features, window_positions
from shared.motion.features import JOINT_POSITIONS, JOINT_VELOCITIES, ROOT_VELOCITY
from shared.motion.skeleton import CANONICAL

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]

BLEND_FRAMES = 6
"""0.3 s; more where poses or speeds lie far apart."""
MOST_BLEND_FRAMES = 14
NEIGHBOURS = 8
MAX_SPEED_GAP_MPS = 0.5
"""Joints whose roots differ more in velocity are not made: the blend would change speed faster than legs can. A run is
entered from a stand by way of a recorded or made start, and left by way of a stop."""
_BLENDED = np.r_[0:67]
"""Features that carry the state: rates and height of the root, joint positions. The rest is derived from them."""


def match_vectors(features: Features) -> Array:
    """(N, 19) what must agree at a joint: feet and wrists in the root frame, velocities of root and feet (weighted)."""
    joints = features[:, JOINT_POSITIONS].reshape(len(features), 21, 3)
    velocities = features[:, JOINT_VELOCITIES].reshape(len(features), 22, 3)
    feet = CANONICAL.indices("left_ankle", "right_ankle")
    wrists = CANONICAL.indices("left_wrist", "right_wrist")
    return np.concatenate(
        [
            2.0 * joints[:, feet - 1].reshape(len(features), -1),
            0.6 * joints[:, wrists - 1].reshape(len(features), -1),
            0.7 * features[:, ROOT_VELOCITY],
            2.0 * features[:, 3:4],
            0.2 * velocities[:, feet, :2].reshape(len(features), -1),
        ],
        axis=-1,
    ).astype(np.float64)


class JoinFinder:
    """Finds, for a frame of any clip, frames of a wanted behaviour whose pose and speed are near.

    Args:
        features: (N, 263) of all clips.
        behaviour: (N,) behaviour number of each frame.
        enterable: (N,) bool: frames at which a join may enter (something before, enough after them).
    """

    def __init__(self, features: Features, behaviour: Index, enterable: npt.NDArray[np.bool_]):
        self._vectors = match_vectors(features)
        self._frames: dict[int, Index] = {}
        self._trees: dict[int, cKDTree] = {}
        for number in np.unique(behaviour[enterable]):
            frames = np.flatnonzero(enterable & (behaviour == number))
            self._frames[int(number)] = frames
            self._trees[int(number)] = cKDTree(self._vectors[frames])

    @property
    def behaviours(self) -> list[int]:
        """Numbers of the behaviours that can be entered."""
        return sorted(self._trees)

    def find(self, last: int, behaviour: int, rng: np.random.Generator) -> tuple[int, float]:
        """A frame of `behaviour` to follow frame `last`, drawn from the nearest, and its distance."""
        tree = self._trees[behaviour]
        distance, place = tree.query(self._vectors[last], k=min(NEIGHBOURS, tree.n), eps=0.3)
        distance, place = np.atleast_1d(distance), np.atleast_1d(place)
        good = np.flatnonzero(distance <= 1.5 * distance[0] + 0.05)
        pick = int(rng.choice(good))
        return int(self._frames[behaviour][place[pick]]), float(distance[pick])


def join(features: Features, last: Index, enter: Index, frames_before: Index, blend: Index, length: int) -> Features:
    """Windows that follow one clip up to a frame and another from there on.

    Args:
        features: (N, 263) of all clips.
        last: (B,) last frame taken of the first clip; enter: (B,) first frame taken of the second.
        frames_before: (B,) frames of the window that come from the first clip.
        blend: (B,) frames over which the difference at the joint fades.
        length: frames of a window.

    Returns:
        (B, length, 263), consistent features: velocities, rotations and contacts are derived anew.
    """
    t = np.arange(length)[None]
    after = t - frames_before[:, None]
    source = np.where(after < 0, last[:, None] + 1 + after, enter[:, None] + after)
    windows = features[source].astype(np.float64)
    gap = features[last].astype(np.float64) - features[enter - 1]
    x = np.clip((after + 1) / (blend[:, None] + 1), 0.0, 1.0)
    left = np.where(after >= 0, 1.0 - x * x * (3.0 - 2.0 * x), 0.0)
    windows[..., _BLENDED] += left[..., None] * gap[:, None, _BLENDED]
    positions = window_positions(windows)
    rotations = rotations_of(windows.astype(np.float32))
    changed = left > 0
    rotations[changed] = ik_6d(positions[changed])
    return window_features(positions, rotations)


def speed_gap_mps(features: Features, last: int, enter: int) -> float:
    """By how much the root's horizontal velocity jumps from frame `last` to what comes before frame `enter`."""
    gap = features[last, ROOT_VELOCITY].astype(np.float64) - features[enter - 1, ROOT_VELOCITY]
    return float(np.linalg.norm(gap))


def blend_frames(distance: npt.ArrayLike) -> Index:
    """Frames of blending (B,) for joints at these distances (B,)."""
    d = np.asarray(distance, dtype=np.float64)
    return np.clip(BLEND_FRAMES + 10.0 * np.maximum(d - 0.3, 0.0), BLEND_FRAMES, MOST_BLEND_FRAMES).astype(np.int64)
