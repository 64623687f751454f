"""Motion to test DiP with, made on the spot: no recorded data needed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch

from planner_service.text.bert import BertConfig
from planner_service.text.encoder import FloatArray, TextEncoderSpec
from shared.data.corpus import ClipInfo, write_corpus
from shared.motion.ik import standing_clip

Array = npt.NDArray[np.float64]


def moving_body(
    frames: int, fps: float, speed_mps: float = 1.0, yaw_rate_radps: float = 0.3, phase: float = 0.0
) -> Array:
    """(T, 22, 3) a standing body carried along an arc, its joints swaying: smooth, with every feature in use."""
    body = standing_clip(1, fps).positions_w_m[0]
    t = np.arange(frames) / fps
    yaw = yaw_rate_radps * t
    c, s = np.cos(yaw), np.sin(yaw)
    sway = 0.03 * np.sin(2 * np.pi * (0.7 * t[:, None, None] + np.arange(22)[None, :, None] / 5 + phase))
    local = body[None] + sway * np.array([1.0, 0.5, 0.3])
    out = local.copy()
    out[..., 0] = c[:, None] * local[..., 0] - s[:, None] * local[..., 1]
    out[..., 1] = s[:, None] * local[..., 0] + c[:, None] * local[..., 1]
    path = np.cumsum(np.stack([c, s], axis=-1) * speed_mps / fps, axis=0)
    out[..., :2] += path[:, None]
    return out


def write_small_corpus(folder: Path) -> Path:
    """A corpus of six clips in two behaviours, one of them held out."""
    clips = []
    for i in range(6):
        walk = i % 2 == 0
        motion = moving_body(150, 30.0, 1.0 if walk else 0.0, 0.2 * (i - 2), i / 6)
        info = ClipInfo(
            name=f"clip{i}",
            take=f"take{i}",
            source="made",
            behaviour="walk" if walk else "stand",
            action="walk" if walk else "stand",
            texts=("a person walks", "walk") if walk else ("a person stands still",),
            split="heldout" if i == 4 else "train",
            made=True,
            mirrored=False,
            start=0,
            frames=len(motion),
            weight=0.0 if i == 4 else 0.2,
        )
        clips.append((info, motion.astype(np.float32)))
    write_corpus(folder, clips, {"format": 1})
    return folder


class HashEncoder:
    """Token features that differ from text to text; stands where MiniLM would, so that tests start at once."""

    config = BertConfig(vocabulary=30522, width=384, layers=6, heads=12, ff=1536, positions=512, token_types=2)

    @property
    def spec(self) -> TextEncoderSpec:
        return TextEncoderSpec("minilm-l6-v2", 384, "0", 8)

    def encode(self, texts: Sequence[str]) -> list[FloatArray]:
        return [
            np.random.default_rng(sum(t.encode())).normal(size=(1 + len(t.split()), 384)).astype(np.float32)
            for t in texts
        ]

    def below(self, text: str, layers: int) -> torch.Tensor:
        """As `PretrainedTextEncoder.below`: the same features, whatever the layer."""
        return torch.from_numpy(self.encode([text])[0][None, 1:])
