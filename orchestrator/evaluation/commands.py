"""What `eval text` asks for: sentences of each kind, built in or from a file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from shared.errors import InvalidInputError
from shared.tasks.interface import Trace
from shared.tasks.kinds import KINDS, LOW_KINDS, judge, lying_down
from shared.tasks.obey import obeyed
from shared.tasks.rules import with_falls

KindsOption = Literal["default", "all"]
LINE = "KIND, tab, sentence"

DEFAULT: dict[str, tuple[str, ...]] = {
    "walk": (
        "a person walks forward.",
        "a person is walking.",
        "walk forward",
        "someone strolls ahead at an easy pace.",
    ),
    "run": ("a person runs forward.", "a person is jogging.", "run", "someone sprints ahead."),
    "turn": ("a person turns left.", "a person turns to the right.", "turn around", "a person turns on the spot."),
    "wave": ("a person waves with the right hand.", "a person waves with the left hand.", "wave", "someone is waving."),
    "jump": ("a person jumps.", "a person jumps up in place.", "jump", "someone hops upward with both feet."),
    "stand": ("a person is standing still.", "stand still", "a person stops and stands.", "someone stands and waits."),
}
"""The six kinds of DESIGN 7, judged by `shared.tasks.obey`."""

ALL: dict[str, tuple[tuple[str, str], ...]] = {
    "walk": tuple(("walk", text) for text in DEFAULT["walk"]),
    "run": tuple(("run", text) for text in DEFAULT["run"]),
    "turn": (
        ("turn_left", "a person turns left."),
        ("turn_right", "a person turns to the right."),
        ("turn", "turn around"),
        ("turn", "a person turns on the spot."),
    ),
    "wave": (
        ("wave_right", "a person waves with the right hand."),
        ("wave_left", "a person waves with the left hand."),
        ("wave", "wave"),
        ("wave", "someone is waving."),
    ),
    "jump": tuple(("jump", text) for text in DEFAULT["jump"]),
    "stand": tuple(("stand", text) for text in DEFAULT["stand"]),
    "squat": (
        ("squat", "a person squats."),
        ("squat", "squat down"),
        ("squat", "someone bends the knees deeply and comes up."),
        ("squat", "a person sits down on the floor."),
    ),
    "punch": (
        ("punch_right", "a person punches with the right hand."),
        ("punch_left", "a person punches with the left hand."),
        ("punch", "throw a punch"),
        ("punch", "someone is boxing."),
    ),
    "kick": (
        ("kick_right", "a person kicks with the right foot."),
        ("kick_left", "a person kicks with the left foot."),
        ("kick", "a person kicks."),
        ("kick", "kick forward"),
    ),
    "step_back": (
        ("step_back", "a person steps back."),
        ("step_back", "step backwards"),
        ("step_back", "take a step back"),
        ("step_back", "someone moves a step backward."),
    ),
    "step_side": (
        ("step_left", "a person steps to the left."),
        ("step_right", "a person steps to the right."),
        ("step_left", "take a step to the left side"),
        ("step_right", "sidestep to the right"),
    ),
}
"""All kinds, each sentence with the kind whose strict rule in `shared.tasks.kinds` it is judged by."""


@dataclass(frozen=True)
class Asked:
    """One command: what it counts as, the rule it is judged by (None: `obey`, which reads the words), and its text."""

    group: str
    rule: str | None
    text: str


@dataclass(frozen=True)
class Outcome:
    """Whether it was done, without falling; whether the body fell; the numbers the first rests on."""

    obeyed: bool
    fell: bool
    measures: dict[str, float]


def choose(count: int, seed: int, kinds: KindsOption = "default") -> list[Asked]:
    """Commands of all kinds in equal shares, never the same kind twice in a row where that can be had."""
    table = (
        {kind: tuple(Asked(kind, None, text) for text in texts) for kind, texts in DEFAULT.items()}
        if kinds == "default"
        else {kind: tuple(Asked(kind, rule, text) for rule, text in texts) for kind, texts in ALL.items()}
    )
    rng = np.random.default_rng(seed)
    out: list[Asked] = []
    deck: list[str] = []
    last = ""
    for _ in range(count):
        if not deck:
            deck = [str(kind) for kind in rng.permutation(list(table))]
        kind = next((k for k in deck if k != last), deck[0])
        deck.remove(kind)
        out.append(table[kind][rng.integers(len(table[kind]))])
        last = kind
    return out


def read_sentences(path: Path) -> list[Asked]:
    """Lines of a kind, a tab and a sentence; empty lines and those that begin with # are passed over.

    Raises:
        InvalidInputError: a line is not that, or its kind has no rule, or there is none at all.
    """
    out = []
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        if not line.strip() or line.startswith("#"):
            continue
        kind, tab, text = line.partition("\t")
        if not tab or not text.strip():
            raise InvalidInputError(
                f"{path}, line {number}: {line!r}", field="sentences", allowed="KIND, tab, sentence"
            )
        if kind.strip() not in KINDS:
            raise InvalidInputError(
                f"{path}, line {number}: unknown kind {kind.strip()!r}", field="sentences", allowed=", ".join(KINDS)
            )
        out.append(Asked(kind.strip(), kind.strip(), text.strip()))
    if not out:
        raise InvalidInputError(f"{path} holds no sentence", field="sentences", allowed=LINE)
    return out


def shares(asked: Sequence[Asked], streams: int, seed: int) -> list[list[Asked]]:
    """A list shuffled and dealt out to `streams` characters."""
    order = np.random.default_rng(seed).permutation(len(asked))
    return [[asked[i] for i in order[stream::streams]] for stream in range(streams)]


def judged(asked: Asked, trace: Trace) -> Outcome:
    """What was done under a command over the ticks that it was in force, and whether the body went down doing it."""
    if asked.rule in LOW_KINDS:
        fell = bool((trace.fallen | lying_down(trace.pos_w_m)).any())
    else:
        fell = bool(with_falls(trace).fallen.any())
    if asked.rule is None:
        found = obeyed(asked.text, trace)
        return Outcome(found.obeyed and not fell, fell, found.measures)
    done = judge(asked.rule, trace)
    return Outcome(done.done and not fell, fell, done.measures)
