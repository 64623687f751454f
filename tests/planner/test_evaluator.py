"""The frozen evaluator: scores by hand, encoders that do not see padding, a training that learns, weights on disk."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from planner_service.text.pretrained import minilm
from planner_service.training.dataset import Material, load_material
from planner_service.training.evaluator.meanings import meaning, meanings_of
from planner_service.training.evaluator.network import EvaluatorConfig, EvaluatorNetwork, contrastive_loss
from planner_service.training.evaluator.pairs import LEAST, PairSampler, fixed_pairs
from planner_service.training.evaluator.scores import (
    diversity,
    draw_pools,
    fid,
    multimodal_distance,
    other_meaning,
    r_precision,
)
from planner_service.training.evaluator.train import fit, retrieval, spread_of
from planner_service.training.evaluator.weights import SHIPPED, Evaluator, load_evaluator, save_evaluator
from shared.data.corpus import Corpus
from shared.errors import InvalidInputError, UnavailableError
from tests.planner.dip_helpers import HashEncoder, write_small_corpus

SMALL = EvaluatorConfig(width=16, heads=2, ff=32, motion_layers=1, text_layers=1, embedding=8, dropout=0.0)


@pytest.fixture(scope="module")
def material(tmp_path_factory: pytest.TempPathFactory) -> Material:
    return load_material(Corpus.load(write_small_corpus(tmp_path_factory.mktemp("evaluator") / "c")), "train", 60)


def test_r_precision_counts_pools_in_which_the_own_sentence_is_near() -> None:
    """Motions on a line: 0 and 1 are nearest to their own sentences, 2 is farthest from its own."""
    motion = np.array([[0.0], [1.0], [2.0]])
    sentence = np.array([[0.0], [1.6], [-5.0]])
    pools = np.array([[[1, 2]], [[0, 2]], [[0, 1]]])
    # Motion 1 is 0.6 from its own and 1.0 from sentence 0; motion 2 is 7 from its own, 2 and 0.4 from the others.
    np.testing.assert_allclose(r_precision(motion, sentence, sentence, pools), [2 / 3, 2 / 3, 1.0])
    flat = np.zeros((3, 1))
    assert r_precision(flat, flat, flat, pools)[0] == 0.0, "what is all alike finds nothing"


@given(st.integers(2, 6), st.integers(2, 40), st.integers(0, 5))
@settings(max_examples=25, deadline=None)
def test_pools_hold_no_two_of_one_meaning(kinds: int, samples: int, seed: int) -> None:
    labels = np.resize(np.arange(kinds), max(samples, kinds))
    pools = draw_pools(other_meaning(labels), labels, 3, np.random.default_rng(seed), size=4)
    assert pools.shape == (len(labels), 3, min(4, kinds) - 1)
    for i, draws in enumerate(pools):
        for pool in draws:
            inside = [labels[i], *labels[pool]]
            assert len(set(inside)) == len(inside)


def test_one_meaning_alone_has_no_pool() -> None:
    with pytest.raises(InvalidInputError):
        draw_pools(other_meaning(np.zeros(3, np.int64)), np.zeros(3, np.int64), 1, np.random.default_rng(0))


def test_fid_of_gaussians_by_hand() -> None:
    """Same covariance, means 3 apart: 9. Scaled about the mean by 2: tr(C + 4C - 2 * 2C) = tr(C)."""
    one = np.random.default_rng(0).normal(size=(200, 4))
    assert abs(fid(one, one)) < 1e-9
    assert abs(fid(one, one + [3.0, 0.0, 0.0, 0.0]) - 9.0) < 1e-9
    mean = one.mean(0)
    assert abs(fid(one, mean + 2 * (one - mean)) - np.trace(np.cov(one, rowvar=False))) < 1e-9


def test_distances_by_hand() -> None:
    motion = np.array([[0.0, 0.0], [3.0, 4.0]])
    assert multimodal_distance(motion, motion + [0.0, 2.0]) == 2.0
    # Two points 5 apart, drawn alike half of the time.
    assert 1.5 < diversity(motion, np.random.default_rng(0)) < 3.5
    assert diversity(np.ones((4, 2)), np.random.default_rng(0)) == 0.0


def test_meanings_are_actions_with_a_side() -> None:
    assert meaning("turn", ["turn left", "a turn to the left"]) == "turn:left"
    assert meaning("turn", ["turn left, then right"]) == "turn"
    assert meaning("jump", ["jump"]) == "jump"


def test_the_most_specific_sentences_are_those_of_the_fewest_meanings(material: Material) -> None:
    found = meanings_of(material)
    assert found.names == ("stand", "walk")
    assert found.said.sum(1).tolist() == [1] * len(material.sentences)
    assert found.specific(material.texts[0]) == list(material.texts[0])


def test_what_is_behind_a_motion_changes_nothing() -> None:
    torch.manual_seed(0)
    network = EvaluatorNetwork(SMALL).eval()
    motion = torch.randn(2, 48, 263)
    length = torch.tensor([40, 48])
    alone = network.motion(motion[:1, :40], length[:1])
    other = motion.clone()
    other[0, 40:] = 7.0
    torch.testing.assert_close(network.motion(motion, length)[:1], alone, atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(network.motion(other, length)[:1], alone, atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(alone.norm(dim=-1), torch.ones(1))
    tokens, mask = torch.randn(1, 5, 384), torch.tensor([[True, True, True, False, False]])
    torch.testing.assert_close(
        network.sentence(tokens, mask), network.sentence(tokens[:, :3], mask[:, :3]), atol=1e-5, rtol=1e-4
    )


def test_the_loss_takes_all_of_a_meaning_as_matches() -> None:
    """Two sentences of one meaning, each at a right angle to its own motion and at the place of the other's."""
    motion = torch.tensor([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]])
    sentence = torch.tensor([[0.0, 1.0], [1.0, 0.0], [-1.0, 0.0]])
    fits = torch.tensor([[True, True, False], [True, True, False], [False, False, True]])
    own, scale = torch.eye(3, dtype=torch.bool), torch.tensor(20.0)
    # Rows and columns of the two: half of 20 where both match, 20 where only their own does; nothing of the third.
    assert float(contrastive_loss(motion, sentence, fits, scale)) == pytest.approx(20 / 3, abs=1e-3)
    assert float(contrastive_loss(motion, sentence, own, scale)) == pytest.approx(40 / 3, abs=1e-3)


def test_stretches_lie_within_their_clips(material: Material) -> None:
    found = meanings_of(material)
    sampler = PairSampler(material, found, 0)
    pairs = sampler.draw(64)
    assert (pairs.frames >= LEAST).all() and (pairs.frames % 4 == 0).all()
    assert (pairs.begin >= material.start[pairs.clip]).all()
    assert (pairs.begin + pairs.frames <= material.start[pairs.clip] + material.length[pairs.clip]).all()
    for clip, sentence in zip(pairs.clip, pairs.sentence, strict=True):
        assert sentence in material.texts[clip]
    again = PairSampler(material, found, 0).draw(64)
    np.testing.assert_array_equal(pairs.begin, again.begin)
    features, length = sampler.features(pairs)
    row = int(np.argmin(pairs.frames))
    begin, frames = pairs.begin[row], pairs.frames[row]
    np.testing.assert_array_equal(features[row, :frames], material.features[begin : begin + frames])
    assert int(length[row]) == frames


def test_fixed_pairs_follow_the_prefix(material: Material) -> None:
    pairs = fixed_pairs(material, meanings_of(material), 20, 0)
    assert len(pairs.clip) == len(material.length)
    np.testing.assert_array_equal(pairs.begin, material.start[pairs.clip] + 20)


def test_training_tells_two_behaviours_apart_and_weights_come_back(material: Material, tmp_path: Path) -> None:
    torch.manual_seed(0)
    network, normalizer = EvaluatorNetwork(SMALL), spread_of(material, meanings_of(material), 0, batches=1)
    found, encoder = meanings_of(material), HashEncoder()
    losses = fit(network, normalizer, material, found, encoder, 40, 16, 3e-3, 0)
    assert np.mean(losses[-5:]) < 0.8 * np.mean(losses[:5])
    trained = Evaluator(network, normalizer, encoder, "")
    assert retrieval(trained, material, found, 0)["r_precision"][0] == 1.0
    digest = save_evaluator(tmp_path / "e.safetensors", network, normalizer, {"steps": 40})
    back = load_evaluator(encoder, tmp_path / "e.safetensors")
    assert back.sha256 == digest
    motion = [material.features[:50], material.features[:44]]
    # fp16 on disk keeps three digits.
    np.testing.assert_allclose(back.embed_motions(motion), trained.embed_motions(motion), atol=5e-3)
    with pytest.raises(InvalidInputError):
        back.embed_motions([material.features[:3]])


def test_other_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UnavailableError):
        load_evaluator(HashEncoder(), tmp_path / "none.safetensors")
    (tmp_path / "bad.safetensors").write_bytes(b"no weights")
    with pytest.raises(InvalidInputError):
        load_evaluator(HashEncoder(), tmp_path / "bad.safetensors")


def test_the_shipped_evaluator_knows_words() -> None:
    """Sentences that mean the same lie closer than others, by its own embeddings, which never saw these wordings."""
    evaluator = load_evaluator(minilm(), SHIPPED)
    texts = [
        "someone walks straight on",
        "the person walks ahead",
        "somebody leaps into the air",
        "the person jumps up",
    ]
    walk, ahead, leap, jump = evaluator.embed_texts(texts)
    assert walk @ ahead > max(walk @ leap, ahead @ jump)
    assert leap @ jump > max(walk @ leap, ahead @ jump)
