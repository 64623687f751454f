"""Which texts are far from all that the shipped planner was trained on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from planner_service.text.encoder import TextEncoder
from planner_service.text.known import KnownSentences
from planner_service.text.meaning import MeaningHead
from planner_service.text.pretrained import PretrainedTextEncoder, minilm
from planner_service.training.meanings import Told, fit, told_right
from planner_service.training.sentences import meanings_of_sentences, pooled
from shared.data.texts import OUT_OF_SCOPE, PARAPHRASES, clean, sentences

NEAR = """walk forward | a person is walking. | somebody jogs | sprint | make a left turn | leap into the air
stand idle | a guy is waving his left arm | person running fast | someone dashes ahead | stroll along
say hi with your hand | hop on the spot | turn around and walk back | someone strolls ahead at an easy pace."""
FAR = """bake a cake | quantum chromodynamics | write python code | the stock market fell | asdf qwer | cook dinner
knit a sweater | swim across the lake | drive a car | read a book | write a letter | the cat sat on the mat"""


def lines(text: str) -> list[str]:
    return [part.strip() for part in text.replace("\n", "|").split("|")]


@pytest.fixture(scope="module")
def encoder() -> PretrainedTextEncoder:
    torch.set_num_threads(1)
    return minilm()


@pytest.fixture(scope="module")
def known(encoder: PretrainedTextEncoder) -> KnownSentences:
    return KnownSentences.load(head=MeaningHead.load(encoder.config, encoder.below))


def test_paraphrases_are_near_and_other_activities_far(known: KnownSentences, encoder: TextEncoder) -> None:
    assert [text for text in lines(NEAR) if known.nearest(text, encoder).far] == []
    assert [text for text in lines(FAR) if not known.nearest(text, encoder).far] == []
    shown = set(clean(OUT_OF_SCOPE))
    assert not shown & set(clean([*lines(NEAR), *lines(FAR)]))
    assert not shown & {text for written in PARAPHRASES.values() for text in clean(written)}


def test_ways_on_foot_are_known_wherever_they_lead(known: KnownSentences, encoder: TextEncoder) -> None:
    for text in ("walk the dog to the park", "carry on along the pavement"):
        found = known.nearest(text, encoder)
        assert not found.far and found.meaning == "walk" and found.taken_as is not None
    assert known.nearest("drive a car", encoder).far


def test_who_is_told_to_stop_is_not_sent_walking_first(known: KnownSentences, encoder: TextEncoder) -> None:
    for text in ("a person stops and stands.", "come to a full stop now", "bring it to a halt"):
        found = known.nearest(text, encoder)
        assert found.meaning == "stand" and found.taken_as is not None and "walk" not in found.taken_as, text
    found = known.nearest("walk up to the fence and stop there", encoder)
    assert found.meaning in ("walk_stop", "walk_start_stop") and found.taken_as and "walk" in found.taken_as


def test_what_means_something_that_no_motion_shows_is_far(known: KnownSentences, encoder: TextEncoder) -> None:
    assert known.head is not None and known.head.most_likely("do a lunge") == "lunge"
    found = known.nearest("do a lunge", encoder)
    assert (found.far, found.meaning, found.taken_as) == (True, None, None)


def test_a_training_sentence_is_its_own_nearest_however_it_is_written(
    known: KnownSentences, encoder: TextEncoder
) -> None:
    for sentence in known.sentences[::40]:
        found = known.nearest(f" {sentence.capitalize()}. ", encoder)
        assert found.sentence == sentence
        assert found.similarity == pytest.approx(1.0, abs=2e-3)  # kept as float16


def test_saved_and_loaded_they_are_the_same(encoder: TextEncoder, tmp_path: Path) -> None:
    made = KnownSentences(("walk", "run"), np.stack([f[0] for f in encoder.encode(["walk", "run"])]), encoder.spec.name)
    made.save(tmp_path / "few.npz")
    assert KnownSentences.load(tmp_path / "few.npz").nearest("run", encoder).sentence == "run"


def test_unseen_sentences_are_taken_for_known_ones_of_the_same_meaning(
    known: KnownSentences, encoder: TextEncoder
) -> None:
    meant = meanings_of_sentences()
    right, cases = 0, 0
    for action, written in PARAPHRASES.items():
        for sentence in written:
            for side in ("left", "right") if "{s}" in sentence else ("",):
                (text,) = sentences(action, side, {action: (sentence,)})
                found = known.nearest(text, encoder)
                cases += 1
                right += (f"{action}:{side}" if side else action) in meant.get(found.taken_as or found.sentence, [])
    assert cases > 200
    assert right / cases >= 0.8  # .84; the nearest sentences alone: .62


def test_neither_a_known_sentence_nor_nonsense_is_taken_for_another(
    known: KnownSentences, encoder: TextEncoder
) -> None:
    for text in [*known.sentences[::40], *lines(FAR)]:
        assert known.nearest(text, encoder).taken_as is None
    left, right = (known.nearest(f"kick it with your {side} foot", encoder).taken_as for side in ("left", "right"))
    assert left and right and "left" in left and "right" in right


def test_layers_fitted_to_few_sentences_tell_others_of_two_meanings_saved_and_loaded_too(
    encoder: PretrainedTextEncoder, tmp_path: Path
) -> None:
    few = {text: (action,) for action in ("run", "sit_down") for text in clean(sentences(action)[:80])}
    told = Told.of({**few, **dict.fromkeys(clean(OUT_OF_SCOPE[:80]), ())}, encoder)
    shown, others = np.arange(len(told.meant))[::2], np.arange(len(told.meant))[1::2]
    layers = fit(told, encoder, shown, seed=0)
    assert told_right(layers, told, others).mean() > 0.9
    again = fit(told, encoder, shown, seed=0)
    assert all(torch.equal(a, b) for a, b in zip(layers.parameters(), again.parameters(), strict=True))
    made = MeaningHead(told.names, layers, encoder.below)
    made.save(tmp_path / "few.safetensors")
    loaded = MeaningHead.load(encoder.config, encoder.below, tmp_path / "few.safetensors")
    assert loaded.names == made.names == ("run", "sit_down")
    for text, meaning in (("he sprints off", "run"), ("take a seat", "sit_down"), ("a dish of lentils", None)):
        np.testing.assert_allclose(loaded.shares(text), made.shares(text), atol=0.01)
        assert loaded.most_likely(text) == made.most_likely(text) == meaning
        assert loaded.shares(text) is loaded.shares(text)  # kept
    rows = pooled(list(few), encoder)
    known = KnownSentences(tuple(few), rows, encoder.spec.name, list(few.values()), loaded)
    taken = known.nearest("somebody is sprinting really quickly", encoder).taken_as
    assert taken is not None and few[taken] == ("run",)
