"""Sentences for what a clip shows. `{s}` is the side as seen by the person; mirroring swaps left and right."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path

import yaml

BEHAVIOURS = (
    "walk", "run", "turn", "stand", "wave", "jump", "punch", "kick", "squat", "sneak", "dance", "gesture", "get_up",
    "lie_down", "pick_up", "throw", "sit", "rise", "step_back", "step_side", "exercise", "other",
)  # fmt: skip
"""Canonical behaviour ids of the corpus."""


def _read(name: str) -> dict[str, tuple[str, ...]]:
    data = yaml.safe_load((Path(__file__).parent / name).read_text(encoding="utf-8"))
    return {action: tuple(texts) for action, texts in data.items()}


SENTENCES = _read("sentences.yaml")
"""Sentences of each action, `{s}` for the side."""

PARAPHRASES = _read("paraphrases.yaml")
"""Sentences that no clip carries, of many of the actions: held out to measure what unseen words do."""

OUT_OF_SCOPE = tuple(text for texts in _read("out_of_scope.yaml").values() for text in texts)
"""Texts that ask for nothing that the corpus shows."""

_NO_MOTION = re.compile(r"<|>|https?:|www\.|\.com\b", re.IGNORECASE)


def sentences(action: str, side: str = "", of: Mapping[str, tuple[str, ...]] = SENTENCES) -> list[str]:
    """Sentences of an action with its side filled in; those that need a side are left out where there is none."""
    return [s.replace("{s}", side) for s in of[action] if side or "{s}" not in s]


def swap_sides(text: str) -> str:
    """The sentence with left and right (and the turning senses) exchanged."""
    pairs = (("left", "right"), ("leftward", "rightward"), ("leftwards", "rightwards"),
             ("clockwise", "counterclockwise"))  # fmt: skip
    swap = {a: b for x, y in pairs for a, b in ((x, y), (y, x))}

    def other(match: re.Match[str]) -> str:
        word = match.group(0)
        new = swap[word.lower()]
        return new.capitalize() if word[0].isupper() else new

    return re.sub(r"\b(" + "|".join(swap) + r")\b", other, text, flags=re.IGNORECASE)


def clean(texts: Iterable[str]) -> list[str]:
    """Lower-case sentences without a full stop, each once, in order; advertisements in the sources are dropped."""
    out: list[str] = []
    for text in texts:
        words = " ".join(text.strip().rstrip(".").lower().split())
        if words and words not in out and not _NO_MOTION.search(words):
            out.append(words)
    return out
