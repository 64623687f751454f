"""Embed a corpus' sentences: `python -m planner_service.training.sentences --corpus DIR [--out FILE]`.

Run with the corpus that the shipped weights were trained on: the file says which texts they have seen the like of. What
other texts mean is told by layers fitted to all sentences of shared/data (`planner_service.training.meanings`).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import numpy.typing as npt
import torch
import typer

from planner_service.text.encoder import TextEncoder
from planner_service.text.known import SHIPPED_SENTENCES, KnownSentences
from planner_service.text.pretrained import minilm
from shared.console import errors_for_people
from shared.data.corpus import Corpus
from shared.data.texts import SENTENCES, clean


def meanings_of_sentences() -> dict[str, Sequence[str]]:
    """What each written sentence means, `ACTION` or `ACTION:SIDE`; some mean more than one thing."""
    out: dict[str, list[str]] = {}
    for action, written in SENTENCES.items():
        for sentence in written:
            for side in ("left", "right") if "{s}" in sentence else ("",):
                (plain,) = clean([sentence.replace("{s}", side)])
                out.setdefault(plain, []).append(f"{action}:{side}" if side else action)
    return {sentence: tuple(sorted(set(meanings))) for sentence, meanings in out.items()}


def pooled(texts: Sequence[str], encoder: TextEncoder) -> npt.NDArray[np.float32]:
    """(N, D) pooled tokens of length 1."""
    rows = np.stack([features[0] for features in encoder.encode(texts)])
    return np.asarray(rows / np.linalg.norm(rows, axis=-1, keepdims=True), dtype=np.float32)


def embed(corpus: Corpus, encoder: TextEncoder) -> KnownSentences:
    """The distinct sentences of the training split, sorted, with their pooled token and what they mean."""
    found = sorted(set(clean(text for i in corpus.select(split="train") for text in corpus.clips[i].texts)))
    known = meanings_of_sentences()
    meanings = [known.get(sentence, ()) for sentence in found]
    return KnownSentences(tuple(found), pooled(found, encoder), encoder.spec.name, meanings)


def main(
    corpus: Annotated[Path, typer.Option(help="folder of a corpus")],
    out: Annotated[Path, typer.Option(help="file to write")] = SHIPPED_SENTENCES,
) -> None:
    """Write the file of known sentences."""
    torch.set_num_threads(1)
    with errors_for_people():
        encoder = minilm()
        known = embed(Corpus.load(corpus), encoder)
    known.save(out)
    typer.echo(f"{len(known.sentences)} sentences -> {out}")


if __name__ == "__main__":
    typer.run(main)
