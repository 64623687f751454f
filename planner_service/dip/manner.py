"""How plans are sampled for what a text means: some motion wants more guidance, some less, and arms that swing more.

What the network foresees in the noisy steps is a mean over phases, and so smaller than any motion. Sampled in ten steps
it stays smaller: a wave swings by a third of a recorded one, and from plan to plan (a small wave as prefix is gone on
with as a small wave) less. Guidance shrinks it more, but makes whole steps aside and back of half-hearted ones (tables
in docs/experiments_planner.md; of kicks it makes such as throw the body).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from shared.motion.features import JOINT_POSITIONS, JOINT_VELOCITIES
from shared.motion.metrics import limb_speed_mps
from shared.motion.skeleton import CANONICAL
from shared.protocol.rates import PLANNER_FPS

SPREAD_FRAMES = 6
"""What swings is what differs from the mean over this standard deviation (0.3 s); waves come back in half a second."""
QUICK_FRAMES = 1.5
"""What is quicker than this no swing is: in lively manners it is left out, as it would grow with the swing."""
SWUNG_STEPS = 6
"""In how many of the last of the trained steps arms are swung more."""
ARMS = CANONICAL.indices("left_elbow", "left_wrist", "right_elbow", "right_wrist")


@dataclass(frozen=True)
class Manner:
    """How a text is sampled where the request does not say.

    Attributes:
        guidance: the scale. coarse: at most this in the noisiest steps.
        swing: in each trained step by which share arms swing more than foreseen.
        lively_mps: speed of limbs (`shared.motion.metrics.limb_speed_mps`) that recordings have; the nearer a prefix is
            to it, the less is swung. None: they swing alike always.
    """

    guidance: float
    coarse: float
    swing: float = 0.0
    lively_mps: float | None = None

    def after(self, prefix_w_m: npt.NDArray[np.floating]) -> Manner:
        """That of a plan which goes on from a prefix (P, 22, 3) at PLANNER_FPS."""
        if self.lively_mps is None:
            return self
        lacks = 1.0 - limb_speed_mps(prefix_w_m, PLANNER_FPS) / self.lively_mps
        return replace(self, swing=self.swing * min(max(lacks, 0.0), 1.0))


FIRM = Manner(7.0, 7.0)
SWINGING = Manner(1.0, 1.0, 0.3)
MANNERS = {"step_back": FIRM, "step_side": FIRM, "walk_side": FIRM, "wave": SWINGING, "wave_both": SWINGING}
"""By action of shared/data; all else as the planner's settings say, but that arms swing more in what is livelier."""
LIVELY_SWING = 2.0
LIVELY_MPS = {
    "dance": 0.36, "dance_salsa": 0.27, "dance_indian": 0.37, "dance_ballet": 0.21, "celebrate": 0.32, "karate": 0.28,
    "elbow_knee": 0.24, "gesture_traffic": 0.2, "gesture_arms": 0.24, "laugh": 0.27, "arm_swing": 0.21, "sword": 0.19,
    "jog_in_place": 0.33, "side_twist": 0.18, "stretch": 0.32, "reach_up": 0.26, "jumping_jack": 0.47,
}  # fmt: skip
"""Median speed of limbs of an action's recordings, in which plans reach a third to a half of it."""


def manner_of(meaning: str | None, usual: Manner) -> Manner:
    """The manner of a meaning, `ACTION` or `ACTION:SIDE`."""
    action = (meaning or "").partition(":")[0]
    if action in LIVELY_MPS:
        return replace(usual, swing=LIVELY_SWING, lively_mps=LIVELY_MPS[action])
    return MANNERS.get(action, usual)


def swung(plans: Tensor, share: Tensor, smooth: Tensor | None = None) -> Tensor:
    """Plans (B, N, F), normalised or not, whose arms swing more by `share` (B,); a new tensor.

    Args:
        smooth: (B,) how much of what is quicker than a swing is left out; nothing by default.
    """
    arms = plans[..., _COLUMNS].transpose(1, 2)
    out = plans.clone()
    slow = _mean(arms, SPREAD_FRAMES)
    swings = arms
    if smooth is not None and bool(smooth.any()):
        swings = arms - smooth[:, None, None] * (arms - _mean(arms, QUICK_FRAMES))
    out[..., _COLUMNS] = (swings + share[:, None, None] * (swings - slow)).transpose(1, 2)
    return out


def _mean(rows: Tensor, spread: float) -> Tensor:
    """Gaussian mean of rows (B, C, N) over their last axis, of this standard deviation."""
    reach = math.ceil(3 * spread)
    kernel = torch.exp(-(torch.arange(-reach, reach + 1) ** 2) / (2.0 * spread**2))
    padded = torch.nn.functional.pad(rows, (reach, reach), mode="replicate").reshape(-1, 1, rows.shape[-1] + 2 * reach)
    return torch.nn.functional.conv1d(padded, (kernel / kernel.sum())[None, None]).reshape(rows.shape)


def _columns() -> list[int]:
    places = [JOINT_POSITIONS.start + 3 * (joint - 1) + axis for joint in ARMS for axis in range(3)]
    return places + [JOINT_VELOCITIES.start + 3 * joint + axis for joint in ARMS for axis in range(3)]


_COLUMNS = _columns()
