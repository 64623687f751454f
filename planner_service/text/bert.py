"""BERT's encoder (Devlin et al. 2019), forward only, for the weights of MiniLM and of DistilBERT.

Written out because it is the whole of what the planner needs of a text library at run time, and it starts in a
fraction of a second. A test holds it equal to the reference implementation.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F


@dataclass(frozen=True)
class BertConfig:
    """Sizes; `token_types` is 0 for DistilBERT, which has none."""

    vocabulary: int
    width: int
    layers: int
    heads: int
    ff: int
    positions: int
    token_types: int
    eps: float = 1e-12


class BertLayer(nn.Module):
    """Post-norm self-attention block."""

    def __init__(self, config: BertConfig):
        super().__init__()
        self.heads = config.heads
        self.query = nn.Linear(config.width, config.width)
        self.key = nn.Linear(config.width, config.width)
        self.value = nn.Linear(config.width, config.width)
        self.out = nn.Linear(config.width, config.width)
        self.norm1 = nn.LayerNorm(config.width, eps=config.eps)
        self.ff1 = nn.Linear(config.width, config.ff)
        self.ff2 = nn.Linear(config.ff, config.width)
        self.norm2 = nn.LayerNorm(config.width, eps=config.eps)

    def forward(self, x: Tensor, mask: Tensor) -> Tensor:
        """x (B, L, W), mask (B, 1, 1, L) True where a token is -> (B, L, W)."""
        b, length, width = x.shape

        def split(y: Tensor) -> Tensor:
            return y.view(b, length, self.heads, width // self.heads).transpose(1, 2)

        attended = F.scaled_dot_product_attention(
            split(self.query(x)), split(self.key(x)), split(self.value(x)), attn_mask=mask
        )
        x = self.norm1(x + self.out(attended.transpose(1, 2).reshape(b, length, width)))
        return self.norm2(x + self.ff2(F.gelu(self.ff1(x))))


class BertEncoder(nn.Module):
    """Token ids -> last hidden states."""

    def __init__(self, config: BertConfig):
        super().__init__()
        self.tokens = nn.Embedding(config.vocabulary, config.width)
        self.positions = nn.Embedding(config.positions, config.width)
        self.types = nn.Embedding(config.token_types, config.width) if config.token_types else None
        self.norm = nn.LayerNorm(config.width, eps=config.eps)
        self.layers = nn.ModuleList(BertLayer(config) for _ in range(config.layers))

    def forward(self, ids: Tensor, mask: Tensor, without_last: int = 0) -> Tensor:
        """ids (B, L) int64, mask (B, L) bool True where a token is -> (B, L, W), after all layers but the last few."""
        x = self.tokens(ids) + self.positions.weight[: ids.shape[1]]
        if self.types is not None:
            x = x + self.types.weight[0]
        x = self.norm(x)
        for layer in self.layers[: len(self.layers) - without_last]:
            x = layer(x, mask[:, None, None, :])
        return x


_EMBEDDINGS = {
    "tokens.": "embeddings.word_embeddings.",
    "positions.": "embeddings.position_embeddings.",
    "types.": "embeddings.token_type_embeddings.",
    "norm.": "embeddings.LayerNorm.",
}
_BERT_LAYER = {
    "query.": "attention.self.query.",
    "key.": "attention.self.key.",
    "value.": "attention.self.value.",
    "out.": "attention.output.dense.",
    "norm1.": "attention.output.LayerNorm.",
    "ff1.": "intermediate.dense.",
    "ff2.": "output.dense.",
    "norm2.": "output.LayerNorm.",
}
_DISTILBERT_LAYER = {
    "query.": "attention.q_lin.",
    "key.": "attention.k_lin.",
    "value.": "attention.v_lin.",
    "out.": "attention.out_lin.",
    "norm1.": "sa_layer_norm.",
    "ff1.": "ffn.lin1.",
    "ff2.": "ffn.lin2.",
    "norm2.": "output_layer_norm.",
}


def load_bert(tensors: Mapping[str, Tensor], config: BertConfig) -> BertEncoder:
    """An encoder with the weights of a published BERT or DistilBERT file; a missing tensor is a KeyError by name."""
    distil = config.token_types == 0
    head = "distilbert." if any(k.startswith("distilbert.") for k in tensors) else ""
    head = "bert." if any(k.startswith("bert.") for k in tensors) else head
    layer_prefix = "transformer.layer." if distil else "encoder.layer."
    layer_names = _DISTILBERT_LAYER if distil else _BERT_LAYER
    model = BertEncoder(config)
    state = {}
    for ours in model.state_dict():
        if ours.startswith("layers."):
            number, rest = ours.removeprefix("layers.").split(".", 1)
            stem, leaf = rest.rsplit(".", 1)
            theirs = f"{layer_prefix}{number}.{layer_names[stem + '.']}{leaf}"
        else:
            stem, leaf = ours.rsplit(".", 1)
            theirs = _EMBEDDINGS[stem + "."] + leaf
        state[ours] = tensors[head + theirs]
    model.load_state_dict(state)
    return model.eval().requires_grad_(False)


def encode_ids(model: BertEncoder, ids: Tensor, mask: Tensor, without_last: int = 0) -> Tensor:
    """`model` without gradients."""
    with torch.inference_mode():
        return model(ids, mask, without_last)
