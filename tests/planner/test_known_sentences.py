"""Which texts are far from all that the shipped planner was trained on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch")

from planner_service.text.encoder import TextEncoder
from planner_service.text.known import KnownSentences
from planner_service.text.pretrained import minilm

NEAR = """walk forward | a person is walking. | somebody jogs | sprint | make a left turn | leap into the air
stand idle | a guy is waving his left arm | person running fast | someone dashes ahead | stroll along
say hi with your hand | hop on the spot | turn around and walk back | someone strolls ahead at an easy pace."""
FAR = """bake a cake | quantum chromodynamics | write python code | the stock market fell | asdf qwer | cook dinner
knit a sweater | swim across the lake | drive a car | read a book | paint the wall | the cat sat on the mat"""


def lines(text: str) -> list[str]:
    return [part.strip() for part in text.replace("\n", "|").split("|")]


@pytest.fixture(scope="module")
def encoder() -> TextEncoder:
    return minilm()


@pytest.fixture(scope="module")
def known() -> KnownSentences:
    return KnownSentences.load()


def test_paraphrases_are_near_and_other_activities_far(known: KnownSentences, encoder: TextEncoder) -> None:
    assert [text for text in lines(NEAR) if known.nearest(text, encoder).far] == []
    assert [text for text in lines(FAR) if not known.nearest(text, encoder).far] == []


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
