"""Encoders that put a sentence and the motion it describes close together.

Shapes: B batch, T frames at 20 fps, L text tokens, W width, E embedding. Embeddings have unit length, so a distance is
between 0 and 2 and a dot product is a cosine.
"""

from __future__ import annotations

import torch
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor, nn
from torch.nn import functional as F

from planner_service.dip.network import Attention, SharedDropout, sinusoid
from shared.motion.features import FEATURES

FRAMES_A_TOKEN = 4
"""A token is four frames (0.2 s)."""


class EvaluatorConfig(BaseModel):
    """Sizes.

    Attributes:
        width, heads, ff: of both transformers; motion_layers, text_layers: their depths.
        embedding: numbers in an embedding.
        most_frames: longest motion.
        text_encoder, text_dim: the frozen encoder that gives token features.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")
    width: int = Field(192, gt=0)
    heads: int = Field(4, gt=0)
    ff: int = Field(384, gt=0)
    motion_layers: int = Field(3, gt=0)
    text_layers: int = Field(1, gt=0)
    embedding: int = Field(128, gt=0)
    dropout: float = Field(0.1, ge=0, lt=1)
    most_frames: int = Field(400, ge=FRAMES_A_TOKEN)
    text_encoder: str = "minilm-l6-v2"
    text_dim: int = Field(384, gt=0)


class _Block(nn.Module):
    """Self-attention and feed-forward, each normalised before and added."""

    def __init__(self, config: EvaluatorConfig):
        super().__init__()
        w = config.width
        self.attention = Attention(w, config.heads)
        self.ff1, self.ff2 = nn.Linear(w, config.ff), nn.Linear(config.ff, w)
        self.norm1, self.norm2 = nn.LayerNorm(w), nn.LayerNorm(w)
        self.drop = SharedDropout(config.dropout)

    def forward(self, x: Tensor, mask: Tensor) -> Tensor:
        y = self.norm1(x)
        x = x + self.drop(self.attention(y, y, mask[:, None, None, :]))
        out: Tensor = x + self.drop(self.ff2(F.gelu(self.ff1(self.norm2(x)))))
        return out


class _Pool(nn.Module):
    """Mean and maximum over the tokens that count, as one vector of unit length."""

    def __init__(self, config: EvaluatorConfig):
        super().__init__()
        self.norm = nn.LayerNorm(config.width)
        self.out = nn.Linear(2 * config.width, config.embedding)

    def forward(self, x: Tensor, mask: Tensor) -> Tensor:
        y, keep = self.norm(x), mask[..., None]
        mean = (y * keep).sum(1) / keep.sum(1).clamp_min(1)
        most = y.masked_fill(~keep, -1e4).amax(1)
        return F.normalize(self.out(torch.cat([mean, most], dim=-1)), dim=-1)


class MotionEncoder(nn.Module):
    """Normalised features of motion to embeddings."""

    def __init__(self, config: EvaluatorConfig):
        super().__init__()
        w = config.width
        self.inward = nn.Linear(FRAMES_A_TOKEN * FEATURES, w)
        self.mix = nn.Linear(w, w)
        self.blocks = nn.ModuleList(_Block(config) for _ in range(config.motion_layers))
        self.pool = _Pool(config)
        self.place: Tensor
        places = torch.arange(config.most_frames // FRAMES_A_TOKEN)
        self.register_buffer("place", sinusoid(places, w), persistent=False)

    def forward(self, features: Tensor, length: Tensor) -> Tensor:
        """Features (B, T, 263), T divisible by 4, of which `length` (B,) count, down to a multiple of 4 -> (B, E).

        What is beyond a motion's length changes nothing, so neither does what else is in the batch.
        """
        tokens = features.shape[1] // FRAMES_A_TOKEN
        x = features.reshape(len(features), tokens, FRAMES_A_TOKEN * FEATURES)
        x = self.mix(F.gelu(self.inward(x))) + self.place[:tokens]
        mask = torch.arange(tokens, device=x.device) < (length // FRAMES_A_TOKEN)[:, None]
        for block in self.blocks:
            x = block(x, mask)
        pooled: Tensor = self.pool(x, mask)
        return pooled


class SentenceEncoder(nn.Module):
    """Token features of a frozen text encoder to embeddings."""

    def __init__(self, config: EvaluatorConfig):
        super().__init__()
        self.inward = nn.Linear(config.text_dim, config.width)
        self.drop = SharedDropout(config.dropout)
        self.blocks = nn.ModuleList(_Block(config) for _ in range(config.text_layers))
        self.pool = _Pool(config)

    def forward(self, tokens: Tensor, mask: Tensor) -> Tensor:
        """Tokens (B, L, text_dim) with mask (B, L), True where one counts -> (B, E)."""
        x = self.drop(self.inward(tokens))
        for block in self.blocks:
            x = block(x, mask)
        pooled: Tensor = self.pool(x, mask)
        return pooled


class EvaluatorNetwork(nn.Module):
    """Both encoders, and the temperature that training finds."""

    def __init__(self, config: EvaluatorConfig):
        super().__init__()
        self.config = config
        self.motion = MotionEncoder(config)
        self.sentence = SentenceEncoder(config)
        self.log_scale = nn.Parameter(torch.tensor(2.6))


def contrastive_loss(motion: Tensor, sentence: Tensor, fits: Tensor, scale: Tensor) -> Tensor:
    """Symmetric cross-entropy of who belongs to whom.

    Args:
        motion, sentence: (B, E) embeddings of unit length, row i of both of one pair.
        fits: (B, B) bool, whether sentence j says what motion i does: true on the diagonal, and for every other pair of
            the same meaning, which counts as a match and not as a wrong answer.
        scale: inverse temperature.
    """
    logits = scale * motion @ sentence.T
    wanted = fits.to(logits.dtype)
    of_motions = wanted / wanted.sum(1, keepdim=True)
    of_sentences = wanted / wanted.sum(0, keepdim=True)
    there = -(of_motions * F.log_softmax(logits, dim=1)).sum(1).mean()
    back = -(of_sentences * F.log_softmax(logits, dim=0)).sum(0).mean()
    return 0.5 * (there + back)
