"""Fit the layers that tell what a text means: `python -m planner_service.training.meanings [--folds 3] [--out FILE]`.

They are MiniLM's own last layers, fitted further to all sentences of shared/data and what they mean (Howard and Ruder
2018 and Devlin et al. 2019 fit whole encoders so), and to texts that mean none of it; the layers before them stay, and
so what they make of a sentence is computed once. No sentence of shared/data/paraphrases.yaml is shown: those measure.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import numpy.typing as npt
import torch
import typer
from torch import Tensor, nn
from torch.nn import functional as F
from torch.nn.utils.rnn import pad_sequence

from planner_service.text.meaning import SHIPPED_MEANINGS, MeaningHead, MeaningLayers
from planner_service.text.pretrained import PretrainedTextEncoder, minilm
from planner_service.training.sentences import meanings_of_sentences
from shared.console import errors_for_people
from shared.data.texts import OUT_OF_SCOPE, clean

LAYERS = 2
"""Fitted of the six: with one of them a third of the sentences is told .916, with two .937, with three .939."""
EPOCHS, BATCH = 6, 64
RATE, HEAD_RATE, WARM_UP = 3e-4, 3e-3, 0.1
WEIGHT_DECAY, MOST_GRADIENT = 0.01, 1.0
HIDDEN_TOKENS, DROPOUT = 0.15, 0.1


@dataclass(frozen=True)
class Told:
    """N sentences as the fitted layers see them.

    Attributes:
        tokens: (N, L, W) what the layers before them make of each. mask: (N, L) True where a token is.
        meant: (N, M + 1) shares of its meanings, the last for none of them; they add up to 1.
        names: of the M meanings.
    """

    tokens: Tensor
    mask: Tensor
    meant: Tensor
    names: tuple[str, ...]

    @classmethod
    def of(cls, meanings: Mapping[str, Sequence[str]], encoder: PretrainedTextEncoder) -> Told:
        """Sentences with their meanings, of which there may be none."""
        rows = [encoder.below(sentence, LAYERS)[0] for sentence in meanings]
        names = tuple(sorted({name for each in meanings.values() for name in each}))
        meant = torch.zeros(len(rows), len(names) + 1)
        for row, each in enumerate(meanings.values()):
            meant[row, [names.index(name) for name in each] or -1] = 1.0 / max(len(each), 1)
        mask = pad_sequence([torch.ones(len(row), dtype=torch.bool) for row in rows], batch_first=True)
        return cls(pad_sequence(rows, batch_first=True), mask, meant, names)


def fit(told: Told, encoder: PretrainedTextEncoder, rows: npt.NDArray[np.int64], seed: int) -> MeaningLayers:
    """Layers fitted to some of the sentences; rare meanings count more, by the root of how rare they are.

    Args:
        told: the sentences. encoder: whose last layers they start from.
        rows: which sentences are shown.
    """
    layers = MeaningLayers(encoder.config, LAYERS, len(told.names))
    layers.layers = nn.ModuleList(copy.deepcopy(layer) for layer in encoder.last(LAYERS))
    layers.requires_grad_(True)
    for zeroed in (layers.head.weight, layers.head.bias):
        nn.init.zeros_(zeroed)
    rng, noise = np.random.default_rng(seed), torch.Generator().manual_seed(seed)
    torch.manual_seed(seed)  # dropout's
    worth = told.meant[rows].sum(0).clamp(min=1.0) ** -0.5
    steps = EPOCHS * math.ceil(len(rows) / BATCH)
    optimizer = torch.optim.AdamW(
        [{"params": layers.layers.parameters()}, {"params": layers.head.parameters()}], weight_decay=WEIGHT_DECAY
    )
    rate = torch.optim.lr_scheduler.OneCycleLR(optimizer, [RATE, HEAD_RATE], steps, pct_start=WARM_UP)
    for _ in range(EPOCHS):
        for batch in _batches(told, rng.permutation(rows), rng):
            length = int(told.mask[batch].sum(1).max())
            shown = told.mask[batch, :length] & (torch.rand(len(batch), length, generator=noise) > HIDDEN_TOKENS)
            shown[:, 0] = True  # [CLS]: something is left of every sentence
            logits = layers(told.tokens[batch, :length], shown, DROPOUT)
            counts = told.meant[batch] @ worth
            loss = (-(told.meant[batch] * F.log_softmax(logits, -1)).sum(1) * counts).sum() / counts.sum()
            optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            nn.utils.clip_grad_norm_(layers.parameters(), MOST_GRADIENT)
            optimizer.step()
            rate.step()
    return layers


def averaged(fits: Sequence[MeaningLayers]) -> MeaningLayers:
    """The mean of layers fitted with different seeds from the same start ("model soup", Wortsman et al. 2022)."""
    mean = copy.deepcopy(fits[0])
    states = [each.state_dict() for each in fits]
    mean.load_state_dict({key: torch.stack([state[key] for state in states]).mean(0) for key in states[0]})
    return mean


def told_right(layers: MeaningLayers, told: Told, rows: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
    """(len(rows),) whether the likeliest meaning is one of the sentence's."""
    with torch.inference_mode():
        best = torch.cat(
            [layers(told.tokens[part], told.mask[part]).argmax(-1) for part in np.split(rows, _cuts(rows))]
        )
    right: npt.NDArray[np.bool_] = (told.meant[rows, best] > 0).numpy()
    return right


def cross_validated(told: Told, encoder: PretrainedTextEncoder, folds: int, fits: int, seed: int) -> float:
    """Share of the sentences told right by the mean of so many fits that were not shown them."""
    parts = np.array_split(np.random.default_rng(seed).permutation(len(told.meant)), folds)
    right = []
    for number, part in enumerate(parts):
        others = np.concatenate([each for k, each in enumerate(parts) if k != number])
        right.append(told_right(averaged([fit(told, encoder, others, seed + k) for k in range(fits)]), told, part))
    return float(np.concatenate(right).mean())


def _cuts(rows: Sequence[int] | npt.NDArray[np.int64]) -> range:
    return range(BATCH, len(rows), BATCH)


def _batches(told: Told, rows: npt.NDArray[np.int64], rng: np.random.Generator) -> list[npt.NDArray[np.int64]]:
    """Rows in batches of about equal length, in random order."""
    lengths = told.mask[rows].sum(1).numpy() + rng.uniform(0.0, 3.0, len(rows))
    batches = np.split(rows[np.argsort(lengths)], _cuts(rows))
    rng.shuffle(batches)
    return batches


def main(
    out: Annotated[Path, typer.Option(help="file to write")] = SHIPPED_MEANINGS,
    folds: Annotated[int, typer.Option(min=0, help="first measure by so many folds; 0: not")] = 0,
    fits: Annotated[int, typer.Option(min=1, help="of which the mean is taken")] = 4,
    seed: Annotated[int, typer.Option(help="of order, dropout and folds; each fit has one more")] = 0,
) -> None:
    """Fit the layers and write them."""
    torch.set_num_threads(1)
    with errors_for_people():
        encoder = minilm()
    told = Told.of(meanings_of_sentences() | dict.fromkeys(clean(OUT_OF_SCOPE), ()), encoder)
    typer.echo(f"{len(told.meant)} sentences, {len(told.names)} meanings")
    if folds:
        typer.echo(f"told right in {folds} folds: {cross_validated(told, encoder, folds, fits, seed):.4f}")
    every = np.arange(len(told.meant))
    layers = averaged([fit(told, encoder, every, seed + k) for k in range(fits)])
    MeaningHead(told.names, layers, encoder.below).save(out)
    typer.echo(f"-> {out}")


if __name__ == "__main__":
    typer.run(main)
