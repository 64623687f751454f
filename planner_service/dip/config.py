"""Sizes of DiP. `tiny` is for tests, `small` ships, `full` has the paper's sizes (REFERENCE 1)."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from shared.errors import InvalidInputError
from shared.motion.features import FEATURES

Size = Literal["tiny", "small", "full"]
ExtraCondition = Literal["velocity", "keyframes"]
EXTRA_CONDITIONS: tuple[ExtraCondition, ...] = ("velocity", "keyframes")
"""Conditions that weights may or may not take, by their names in the protocol; each is a flag of DipConfig."""


class DipConfig(BaseModel):
    """Everything that fixes the network's shape and its diffusion.

    Attributes:
        prefix_frames, plan_frames: clean and planned frames at 20 fps.
        first_arrival_frame: earliest plan frame (counted from 1) at which a target may hold.
        steps: diffusion steps.
        text_encoder, text_dim: name of the text encoder and numbers in one of its tokens.
        norm_first: normalise before each block (trains in fewer steps) instead of after it (the paper's).
        condition_every_frame: add the time and target embedding to every planned frame's token, too, beside its place
            in the memory.
        pooled_text: whitened numbers of the sentence's pooled token that are added to that embedding, too, so that text
            acts on every frame at once (attention alone had hardly learnt to tell "stand" from "walk" after 1,500
            steps); whitened, because "left" and "right" differ by little else; 0 for none.
        keyframes: take places of joints at frames of the plan as a condition of those frames.
        velocity: take a mean velocity over the plan's second half as a condition.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")
    width: int = Field(256, gt=0)
    layers: int = Field(6, gt=0)
    heads: int = Field(4, gt=0)
    ff: int = Field(1024, gt=0)
    dropout: float = Field(0.1, ge=0, lt=1)
    features: int = FEATURES
    prefix_frames: int = Field(20, gt=1)
    plan_frames: int = Field(40, gt=0)
    first_arrival_frame: int = Field(8, gt=0)
    steps: int = Field(10, gt=0)
    text_encoder: str = "minilm-l6-v2"
    text_dim: int = Field(384, gt=0)
    norm_first: bool = True
    condition_every_frame: bool = True
    pooled_text: int = Field(128, ge=0)
    keyframes: bool = False
    velocity: bool = False

    @property
    def extra_conditions(self) -> tuple[ExtraCondition, ...]:
        """Which of EXTRA_CONDITIONS these weights take."""
        return tuple(name for name in EXTRA_CONDITIONS if getattr(self, name))


def preset(size: str) -> DipConfig:
    """Sizes by name; raises InvalidInputError listing the names."""
    presets = {
        "tiny": DipConfig(width=32, layers=2, heads=2, ff=64, dropout=0.0, pooled_text=16),
        "small": DipConfig(),
        "full": DipConfig(
            width=512,
            layers=8,
            heads=4,
            ff=1024,
            dropout=0.1,
            norm_first=False,
            condition_every_frame=False,
            pooled_text=0,
        ),
    }
    if size not in presets:
        raise InvalidInputError(f"unknown size {size!r}", field="size", allowed=", ".join(presets))
    return presets[size]
