"""Embed a corpus' sentences: `python -m planner_service.training.sentences --corpus DIR [--out FILE]`.

Run with the corpus that the shipped weights were trained on: the file says which texts they have seen the like of.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from planner_service.text.encoder import TextEncoder
from planner_service.text.known import SHIPPED_SENTENCES, KnownSentences
from planner_service.text.pretrained import minilm
from shared.console import errors_for_people
from shared.data.corpus import Corpus
from shared.data.texts import clean


def embed(corpus: Corpus, encoder: TextEncoder) -> KnownSentences:
    """The distinct sentences of the training split, sorted, with their pooled token."""
    found = sorted(set(clean(text for i in corpus.select(split="train") for text in corpus.clips[i].texts)))
    return KnownSentences(
        tuple(found), np.stack([features[0] for features in encoder.encode(found)]), encoder.spec.name
    )


def main(
    corpus: Annotated[Path, typer.Option(help="folder of a corpus")],
    out: Annotated[Path, typer.Option(help="file to write")] = SHIPPED_SENTENCES,
) -> None:
    """Write the file of known sentences."""
    with errors_for_people():
        known = embed(Corpus.load(corpus), minilm())
    known.save(out)
    typer.echo(f"{len(known.sentences)} sentences -> {out}")


if __name__ == "__main__":
    typer.run(main)
