"""What an unseen sentence means: MiniLM with its last layers fitted to all that is written in shared/data.

A network that was shown a thousand sentences takes an unseen one for the nearest of them by its words, and is wrong in
one of five ("someone is waving" is nearer to "someone walks forward waving" than to "wave at somebody"). Layers that
were fitted to many more sentences with their meanings know which part of a sentence tells meanings apart; a linear head
on the embedding that MiniLM was published for errs nearly twice as often (docs/experiments_planner.md).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from safetensors import safe_open
from safetensors.torch import save_file
from torch import Tensor, nn
from torch.nn import functional as F

from planner_service.text.bert import BertConfig, BertLayer

Floats = npt.NDArray[np.float32]
Below = Callable[[str, int], Tensor]
"""(1, L, W) what the layers before the last so many make of a text."""

SHIPPED_MEANINGS = Path(__file__).resolve().parent.parent / "weights" / "meanings.safetensors"
SHARPNESS = 20.0
"""The pooled token has length 1; the linear layer is given this times it."""
_REMEMBERED = 1024


class MeaningLayers(nn.Module):
    """The last layers of a BERT, the mean over its tokens, one number a meaning, and one for anything else.

    Args:
        config: of the BERT. layers: how many there are. meanings: how many there are.
    """

    def __init__(self, config: BertConfig, layers: int, meanings: int):
        super().__init__()
        self.layers = nn.ModuleList(BertLayer(config) for _ in range(layers))
        self.head = nn.Linear(config.width, meanings + 1)

    def forward(self, x: Tensor, mask: Tensor, dropout: float = 0.0) -> Tensor:
        """x (B, L, W), mask (B, L) True where a token is -> logits (B, M + 1)."""
        for layer in self.layers:
            x = layer(x, mask[:, None, None, :])
        kept = mask[..., None]
        mean = F.normalize((x * kept).sum(1) / kept.sum(1), dim=-1)
        logits: Tensor = self.head(F.dropout(mean, dropout, dropout > 0.0) * SHARPNESS)
        return logits


class MeaningHead:
    """Says how likely each meaning is for a text. Safe to share by threads.

    Args:
        names: M meanings, an action of shared/data with its side where it has one, e.g. `kick:left`.
        layers: fitted (`planner_service.training.meanings`).
        below: of the encoder that they were fitted to.
    """

    def __init__(self, names: tuple[str, ...], layers: MeaningLayers, below: Below):
        self.names = names
        self.layers = layers.eval().requires_grad_(False)
        self._below = below
        self._shares = lru_cache(_REMEMBERED)(self._compute)

    @classmethod
    def load(cls, config: BertConfig, below: Below, path: Path = SHIPPED_MEANINGS) -> MeaningHead:
        """From a file of `save`."""
        with safe_open(str(path), "pt") as file:
            names = tuple(file.metadata()["names"].split())
            state = {key: file.get_tensor(key).float() for key in file.keys()}  # noqa: SIM118 - not a mapping
        count = len({key.split(".")[1] for key in state if key.startswith("layers.")})
        layers = MeaningLayers(config, count, len(names))
        layers.load_state_dict(state)
        return cls(names, layers, below)

    def save(self, path: Path) -> None:
        """Write the layers (float16) and the names."""
        save_file(
            {k: v.half() for k, v in self.layers.state_dict().items()}, str(path), {"names": " ".join(self.names)}
        )

    def shares(self, text: str) -> Floats:
        """(M + 1,) how likely each meaning of a text is, and last that it is about something else; they add up to 1."""
        return self._shares(text)

    def _compute(self, text: str) -> Floats:
        x = self._below(text, len(self.layers.layers))
        with torch.inference_mode():
            found: Floats = self.layers(x, torch.ones(x.shape[:2], dtype=torch.bool)).softmax(-1)[0].numpy()
        found.flags.writeable = False  # it is kept
        return found

    def most_likely(self, text: str) -> str | None:
        """The meaning of a text; None where it is about something else."""
        best = int(np.argmax(self.shares(text)))
        return self.names[best] if best < len(self.names) else None
