"""How plans are sampled for what a text means: some motion wants more guidance, some less, and arms that swing more.

What the network foresees in the noisy steps is a mean over phases, and so smaller than any motion. Sampled in ten steps
it stays smaller: a wave swings by a third of a recorded one, and from plan to plan (a small wave as prefix is gone on
with as a small wave) less. Guidance shrinks it more, but makes whole steps aside and back of half-hearted ones (tables
in docs/experiments_planner.md; of kicks it makes such as throw the body).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from shared.motion.features import JOINT_POSITIONS, JOINT_VELOCITIES
from shared.motion.skeleton import CANONICAL

SPREAD_FRAMES = 6
"""What swings is what differs from the mean over this standard deviation (0.3 s); waves come back in half a second."""
SWUNG_STEPS = 6
"""In how many of the last of the trained steps arms are swung more."""
ARMS = CANONICAL.indices("left_elbow", "left_wrist", "right_elbow", "right_wrist")


@dataclass(frozen=True)
class Manner:
    """How a text is sampled where the request does not say.

    Attributes:
        guidance: the scale. coarse: at most this in the noisiest steps.
        swing: in each trained step by which share arms swing more than foreseen.
    """

    guidance: float
    coarse: float
    swing: float = 0.0


FIRM = Manner(7.0, 7.0)
SWINGING = Manner(1.0, 1.0, 0.3)
MANNERS = {"step_back": FIRM, "step_side": FIRM, "walk_side": FIRM, "wave": SWINGING, "wave_both": SWINGING}
"""By action of shared/data; all else as the planner's settings say."""


def manner_of(meaning: str | None, usual: Manner) -> Manner:
    """The manner of a meaning, `ACTION` or `ACTION:SIDE`."""
    return usual if meaning is None else MANNERS.get(meaning.partition(":")[0], usual)


def swung(plans: Tensor, share: Tensor) -> Tensor:
    """Plans (B, N, F), normalised or not, whose arms swing more by `share` (B,); a new tensor."""
    reach = 3 * SPREAD_FRAMES
    kernel = torch.exp(-(torch.arange(-reach, reach + 1) ** 2) / (2.0 * SPREAD_FRAMES**2))
    arms = plans[..., _COLUMNS].transpose(1, 2)
    padded = torch.nn.functional.pad(arms, (reach, reach), mode="replicate").reshape(-1, 1, arms.shape[-1] + 2 * reach)
    slow = torch.nn.functional.conv1d(padded, (kernel / kernel.sum())[None, None]).reshape(arms.shape)
    out = plans.clone()
    out[..., _COLUMNS] = (arms + share[:, None, None] * (arms - slow)).transpose(1, 2)
    return out


def _columns() -> list[int]:
    places = [JOINT_POSITIONS.start + 3 * (joint - 1) + axis for joint in ARMS for axis in range(3)]
    return places + [JOINT_VELOCITIES.start + 3 * joint + axis for joint in ARMS for axis in range(3)]


_COLUMNS = _columns()
