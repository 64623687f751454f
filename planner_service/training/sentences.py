"""Embed a corpus' sentences: `python -m planner_service.training.sentences --corpus DIR [--out FILE]`.

Run with the corpus that the shipped weights were trained on: the file says which texts they have seen the like of. The
head that tells what other texts mean is fitted to all sentences of shared/data, also those that came after the corpus.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
import typer
from sklearn.linear_model import LogisticRegression

from planner_service.text.encoder import TextEncoder
from planner_service.text.known import SHIPPED_SENTENCES, KnownSentences
from planner_service.text.meaning import Floats, MeaningHead
from planner_service.text.pretrained import minilm
from shared.console import errors_for_people
from shared.data.corpus import Corpus
from shared.data.texts import SENTENCES, clean


def fit(embeddings: Floats, meanings: Sequence[str], inverse_penalty: float = 100.0) -> MeaningHead:
    """The head of sentences with their meanings, every meaning counting the same.

    Args:
        embeddings: (N, D) of length 1. meanings: N of them, at least two different.
        inverse_penalty: of the weights' squares; 30 to 300 are as good (three-fold: .881, .885, .881).
    """
    names = sorted(set(meanings))
    rows = np.array([names.index(meaning) for meaning in meanings])
    model = LogisticRegression(C=inverse_penalty, max_iter=400, class_weight="balanced").fit(embeddings, rows)
    weights, bias = (np.asarray(x, dtype=np.float32) for x in (model.coef_, model.intercept_))
    if len(names) == 2:  # it keeps one row then
        weights, bias = np.concatenate([-weights, weights]), np.concatenate([-bias, bias])
    return MeaningHead(tuple(names), weights, bias)


def meanings_of_sentences() -> dict[str, list[str]]:
    """What each written sentence means, `ACTION` or `ACTION:SIDE`; some mean more than one thing."""
    out: dict[str, list[str]] = {}
    for action, written in SENTENCES.items():
        for sentence in written:
            for side in ("left", "right") if "{s}" in sentence else ("",):
                (plain,) = clean([sentence.replace("{s}", side)])
                out.setdefault(plain, []).append(f"{action}:{side}" if side else action)
    return {sentence: sorted(set(meanings)) for sentence, meanings in out.items()}


def pooled(texts: Sequence[str], encoder: TextEncoder) -> Floats:
    """(N, D) pooled tokens of length 1."""
    rows = np.stack([features[0] for features in encoder.encode(texts)])
    return np.asarray(rows / np.linalg.norm(rows, axis=-1, keepdims=True), dtype=np.float32)


def fitted_head(encoder: TextEncoder) -> MeaningHead:
    """The head of all written sentences; one with two meanings counts for both."""
    meanings = meanings_of_sentences()
    rows = pooled(list(meanings), encoder)
    pairs = [(row, meaning) for row, each in zip(rows, meanings.values(), strict=True) for meaning in each]
    return fit(np.stack([row for row, _ in pairs]), [meaning for _, meaning in pairs])


def embed(corpus: Corpus, encoder: TextEncoder, head: MeaningHead | None = None) -> KnownSentences:
    """The distinct sentences of the training split, sorted, with their pooled token and what they mean."""
    found = sorted(set(clean(text for i in corpus.select(split="train") for text in corpus.clips[i].texts)))
    known = meanings_of_sentences()
    meanings = [known.get(sentence, []) for sentence in found] if head is not None else ()
    return KnownSentences(tuple(found), pooled(found, encoder), encoder.spec.name, meanings, head)


def main(
    corpus: Annotated[Path, typer.Option(help="folder of a corpus")],
    out: Annotated[Path, typer.Option(help="file to write")] = SHIPPED_SENTENCES,
) -> None:
    """Write the file of known sentences."""
    torch.set_num_threads(1)
    with errors_for_people():
        encoder = minilm()
        known = embed(Corpus.load(corpus), encoder, fitted_head(encoder))
    known.save(out)
    typer.echo(f"{len(known.sentences)} sentences -> {out}")


if __name__ == "__main__":
    typer.run(main)
