"""What a sentence asks for: negated clauses go, steps come one after the other, all else stays as it is."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from shared.data.texts import SENTENCES, sentences
from shared.text.wording import STAND_TEXT, understand

DENIED = """
a person does not walk | don't walk | dont walk | do not walk | A person doesn’t walk. | never walk | no running
a person can't walk | can not walk | a person refuses to walk | nobody walks | not walking | do nothing
a person neither walks nor runs | don't walk or run | don't walk and don't run | do not run and jump | please don't move
a person is not walking | a person no longer walks | he will not jump | no jumping please
take no step at all | make no movement | don't you walk
""".replace("\n", "|").split("|")

KEPT = [
    ("walks without running", "walks"),
    ("a person walks without running", "a person walks"),
    ("without running a person walks", "a person walks"),
    ("without running, a person walks forward", "a person walks forward"),
    ("walk, don't run", "walk"),
    ("don't run, walk", "walk"),
    ("walk. don't run.", "walk"),
    ("NEVER RUN, WALK", "WALK"),
    ("don't walk but wave", "wave"),
    ("do not walk, just wave", "wave"),
    ("a person does not walk but waves", "a person waves"),
    ("a person does not walk and waves", "a person waves"),
    ("a person is not running but walking", "a person is walking"),
    ("he isn't walking, he is waving", "he is waving"),
    ("a person walks and does not wave", "a person walks"),
    ("walk and don't wave", "walk"),
    ("a person walks forward instead of running", "a person walks forward"),
    ("instead of running, walk", "walk"),
    ("rather than running a person walks", "a person walks"),
    ("a person avoids running and walks", "a person walks"),
    ("walk not fast", "walk"),
    ("walk slowly, not quickly", "walk slowly"),
    ("walk with no running", "walk"),
    ("stand still and do nothing", "stand still"),
    ("raise the arm but don't wave it", "raise the arm"),
    ("don't just stand there, run", "run"),
    ("he makes no move but waves", "he waves"),
    ("she takes no steps and waves", "she waves"),
]

AFFIRMED_TWICE = [
    ("never stop walking", "keep walking"),
    ("a person does not stop walking", "a person keeps walking"),
    ("won't you sit down", "sit down"),
    ("can't you walk faster", "walk faster"),
    ("wouldn't you please wave", "wave"),
    ("not only walks but also waves", "walks and waves"),
]

STEPS = [
    ("walk, then wave", ("walk", "wave")),
    ("walk then wave", ("walk", "wave")),
    ("a person walks, then waves", ("a person walks", "a person waves")),
    ("first walk, then wave and finally jump", ("walk", "wave", "jump")),
    ("don't walk, then jump", ("jump",)),
    ("walk, then don't run", ("walk",)),
    ("step to the left then to the right", ("step to the left then to the right",)),
    ("then walk", ("walk",)),
]


@pytest.mark.parametrize("text", [text.strip() for text in DENIED if text.strip()])
def test_where_nothing_is_left_it_stands(text: str) -> None:
    wording = understand(text)
    assert wording.steps == (STAND_TEXT,)
    assert wording.dropped


@pytest.mark.parametrize(("text", "steps"), [(a, (b,)) for a, b in KEPT])
def test_a_negated_clause_is_dropped(text: str, steps: tuple[str, ...]) -> None:
    wording = understand(text)
    assert wording.steps == steps
    assert wording.dropped


@pytest.mark.parametrize(("text", "steps"), [(a, (b,)) for a, b in AFFIRMED_TWICE])
def test_what_only_sounds_negated_stays(text: str, steps: tuple[str, ...]) -> None:
    assert understand(text) == understand(steps[0])


@pytest.mark.parametrize(("text", "steps"), STEPS)
def test_steps_in_order(text: str, steps: tuple[str, ...]) -> None:
    assert understand(text).steps == steps


def test_training_sentences_without_negation_and_steps_pass_unchanged() -> None:
    plain = [
        text
        for action in SENTENCES
        for text in sentences(action, "left")
        if " then " not in f" {text} " and "without" not in text and " not " not in text
    ]
    assert len(plain) > 300
    assert [understand(text).steps for text in plain] == [(text,) for text in plain]


@given(st.text(max_size=300))
def test_any_text_is_something_to_do(text: str) -> None:
    assert all(step.strip() for step in understand(text).steps)
