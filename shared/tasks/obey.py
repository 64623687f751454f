"""Whether a text command was obeyed: what its words ask for, and whether the motion shows it (DESIGN 7)."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from math import degrees, radians
from typing import Literal

from shared.protocol.messages import TICK_HZ, JointTarget
from shared.tasks import rules
from shared.tasks.interface import Trace

Kind = Literal["walk", "run", "turn", "wave", "jump", "stand", "other"]

WALK_M, RUN_MPS, TURN_RAD, WAVE_REVERSALS, JUMP_M, STAND_M = 1.5, 1.8, radians(60), 2, 0.05, 0.2
STAND_SETTLE_S = 2.0
"""A body that was running has this long to come to rest before its drift counts."""

_WORDS: tuple[tuple[Kind, str], ...] = (
    ("wave", r"\bwav(e|es|ing)\b"),
    ("jump", r"\b(jump|hop|leap)(s|ing|ed|ping)?\b"),
    ("turn", r"\b(turn|spin|rotat|pivot)\w*\b"),
    ("run", r"\b(run|jog|sprint)\w*\b"),
    ("walk", r"\b(walk|stroll|march|strut|stride|pac(es|ing)|limp|sneak|step)\w*\b"),
    ("stand", r"\b(stand|stop|halt|still|idle|wait)\w*\b"),
)


def kind_of(text: str) -> Kind:
    """What a sentence asks for, by its words; waving, jumping and turning outrank the gait that carries them."""
    lowered = text.lower()
    for kind, pattern in _WORDS:
        if re.search(pattern, lowered):
            return kind
    return "other"


_LOW = re.compile(
    r"\b(sit|sits|sat|sitting|seat|seated|lie|lies|lying|lays|laying|crawl\w*|kneel\w*|knelt|crouch\w*|squat\w*|duck\w*"
    r"|push-?ups?|sit-?ups?|rolls?|rolling|somersault\w*|falls? down|falling down|collaps\w*|on all fours"
    r"|(get|gets|getting|stand|stands|standing|rise|rises|rising) up|picks?(ing)? (\w+ ){0,3}up|picks?(ing)? up)\b"
)


def asks_low(text: str | None) -> bool:
    """Whether a sentence asks for being low on the way: sitting, lying, crawling, and getting up from there."""
    return text is not None and _LOW.search(text.lower()) is not None


_FLOOR_SEAT = re.compile(
    r"^(?!.*\b(up|ris\w+|rose|stand\w*|stood|lie|lies|lying|lay\w*)\b).*"
    r"\b(sit|sits|sitting|sat|seat|seated)\b.*\b(floor|ground)\b"
)


def asks_floor_seat(text: str | None) -> bool:
    """Whether a sentence asks for sitting on the floor."""
    return text is not None and _FLOOR_SEAT.search(text.lower()) is not None


_BLOW = re.compile(
    r"\b(punch\w*|kick\w*|boxes|boxing|shadow ?box\w*|spar\w*|jab\w*|uppercuts?|hooks?|boot|hits? (it|him|with)"
    r"|fight like a boxer|(strikes?|hits?|attack) with (the |a |your )?(\w+ )?(hand|fists?|foot|leg))\b|^box$"
)
BLOW_TICKS = 42
"""A blow's plan is performed so long, through wind-up, blow and way back: made anew on the way it begins again. So is
the way down to the floor, which takes as long."""


def is_blow(text: str | None, targets: Sequence[JointTarget] = ()) -> bool:
    """Whether a sentence asks for a punch or a kick, and nothing but the sentence says where."""
    return text is not None and not targets and _BLOW.search(text.lower()) is not None


def holds_ticks(text: str | None, targets: Sequence[JointTarget] = ()) -> int:
    """For how long a plan for a sentence is to be performed, in ticks; 0 where it may be made anew at any time, as with
    targets, whose arrival is told."""
    if text is None or targets:
        return 0
    return BLOW_TICKS if is_blow(text) or asks_floor_seat(text) else 0


@dataclass(frozen=True)
class Obedience:
    """Outcome and the number it rests on (SI; the name carries the unit)."""

    kind: Kind
    obeyed: bool
    measures: dict[str, float]


def obeyed(text: str, trace: Trace) -> Obedience:
    """Judge one command over the ticks that it was in force.

    walk >= 1.5 m of path, run >= 1.8 m/s over a second, turn >= 60 deg (to the side that the text names), wave: a
    wrist above its shoulder and two reversals, jump: both feet >= 5 cm up, stand: drift < 0.2 m after two seconds in
    which to stop. `other` has no rule: obeyed means that it did not fall.
    """
    kind = kind_of(text)
    xy = trace.pos_w_m[:, 0, :2]
    if len(trace) < 2:
        return Obedience(kind, False, {})
    if kind == "walk":
        value = rules.travelled_m(xy)
        return Obedience(kind, value >= WALK_M, {"travelled_m": value})
    if kind == "run":
        value = rules.best_speed_mps(xy)
        return Obedience(kind, value >= RUN_MPS, {"speed_mps": value})
    if kind == "turn":
        value = rules.turned_rad(trace.pos_w_m)
        lowered = text.lower()
        side = 1 if re.search(r"\bleft\b", lowered) else -1 if re.search(r"\bright\b", lowered) else 0
        right_way = side == 0 or value * side > 0
        return Obedience(kind, abs(value) >= TURN_RAD and right_way, {"turned_deg": degrees(value)})
    if kind == "wave":
        count = rules.wave_reversals(trace.pos_w_m)
        return Obedience(kind, count >= WAVE_REVERSALS, {"reversals": float(count)})
    if kind == "jump":
        value = rules.jump_height_m(trace.pos_w_m)
        return Obedience(kind, value >= JUMP_M, {"jump_m": value})
    if kind == "stand":
        value = rules.drift_m(xy[min(int(STAND_SETTLE_S * TICK_HZ), len(xy) - 2) :])
        return Obedience(kind, value < STAND_M, {"drift_m": value})
    return Obedience(kind, not bool(trace.fallen.any()), {})
