"""What a sentence asks for: its steps in order, without what it says not to do.

Motion models are trained on sentences that say what is done. "Don't walk" is nearer to "walk" than to anything else
they know, so a character told so walks. Here a negated clause is dropped before a planner sees it, and standing is what
is left of a sentence that says nothing else. "Walk, then wave" is two things, one after the other. Pure functions on
English words; a sentence without negation and without "then" passes through as it is.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

STAND_TEXT = "a person is standing still."

_NOUN = r"(?:a |the |this |that )?(?:person|man|woman|human|figure|character|boy|girl|guy)"
_BARE = rf"{_NOUN}|someone|somebody|he|she|it|they|you"
_SUBJECT = re.compile(rf"^(?:please\s+)?(?P<subject>{_BARE})\b", re.IGNORECASE)
_STEP = re.compile(
    r"\s*[,;.]?\s*(?:\band\s+)?\b(?:then|afterwards?|after that|followed by|and finally|finally)\b\s*,?\s*",
    re.IGNORECASE,
)
_NO_STEP = re.compile(
    r"^\s*(?:to|for|in|on|at|with|into|towards?|again|back|forth|forwards?|left|right|up|down)\b", re.IGNORECASE
)
_FIRST = re.compile(r"^\s*(?:at\s+)?first\b\s*,?\s*", re.IGNORECASE)
_CLAUSE = re.compile(
    r"(\s*[,;:.!]\s*(?:and\s+|but\s+)?|\s+(?:but|yet|however|although|though|while)\s+)", re.IGNORECASE
)
_AUX = r"do|does|did|is|are|am|was|were|has|have|had|will|would|shall|should|can|could|must|may|might|need"
_NOT = re.compile(
    rf"\b(?:(?P<aux>{_AUX})\s+not|(?P<short>{_AUX}|ca|wo)n['’]?t|(?P<fused>dont|doesnt|didnt|isnt|arent|wasnt|wont|cant)"
    r"|(?:takes?|taking|makes?|making)\s+no\s+(?:steps?|moves?|movements?|motions?)"
    r"|cannot|never|not|without|instead\s+of|rather\s+than|nor|neither|no\s+longer|nobody|no\s+one|nothing"
    r"|avoid(?:s|ing)?|refus(?:e|es|ing)\s+to|refrain(?:s|ing)?\s+from|no(?=\s+\w+ing\b))(?!\w)",
    re.IGNORECASE,
)
_POLITE = re.compile(r"^\s*(?:please\s+)?(?:wo|would|can?|could)n['’]?t\s+you\s+(?:please\s+)?", re.IGNORECASE)
"""Asked in the negative, and meant."""
_NOT_ONLY = re.compile(r"\bnot\s+(?:only|just)\s+(.+?),?\s+but\s+(?:also\s+)?", re.IGNORECASE)
_NEVER_STOP = re.compile(
    rf"\b(?:(?:{_AUX})\s+not|(?:{_AUX}|wo|ca)n['’]?t|dont|doesnt|never|not)\s+(?P<stop>stops?|stopping|halt|ceases?)\s+"
    r"(?=\w+ing\b)",
    re.IGNORECASE,
)
_OWN_CLAUSE = re.compile(
    rf"\s+and\s+(?=(?:{_BARE}|{_AUX}|just|instead|only|also|rather|keeps?|never|not|dont|doesnt)\b|(?:{_AUX}|wo|ca)n['’]?t\b)",
    re.IGNORECASE,
)
_THIRD_PERSON = re.compile(r"\s+and\s+(?=\w+[^s\W]s\b)", re.IGNORECASE)
_OF_ONE = re.compile(r"does|avoids|refuses|refrains|takes|makes", re.IGNORECASE)
_LEADING = re.compile(r"^(?:(?:please|just|only|instead|rather|simply|but|and|so|also)\b\s*,?\s*)+", re.IGNORECASE)
_TRAILING = re.compile(r"[\s,]*(?:\b(?:instead|rather|with|and|but|while|or|to|by|at all)\b[\s,]*)+$", re.IGNORECASE)
_EMPTY = re.compile(rf"^(?:{_BARE}|{_AUX}|be|being|doing|just|please|who|that|which|both|\s|[,.;:!])*$", re.IGNORECASE)
_HEAD_PHRASE = re.compile(
    rf"^\s*(?:without|instead\s+of|rather\s+than|never|not)\s+(?P<what>\w+ing\b.*?)\s+(?P<rest>(?:{_BARE})\s+.+)$",
    re.IGNORECASE,
)


@dataclass(frozen=True)
class Wording:
    """A sentence as it is taken.

    Attributes:
        steps: what to do, one thing after the other; at least one.
        dropped: clauses that say what not to do.
    """

    steps: tuple[str, ...]
    dropped: tuple[str, ...] = ()

    @property
    def text(self) -> str:
        """The steps as one sentence."""
        return ", then ".join(self.steps)


def understand(text: str) -> Wording:
    """The steps of a sentence without its negated clauses; standing where nothing is left."""
    steps: list[str] = []
    dropped: list[str] = []
    subject = ""
    text = _POLITE.sub("", text)
    parts = [part for part in _STEP.split(text) if part.strip(" ,.;")]
    if any(_NO_STEP.match(part) for part in parts[1:]):
        parts = [text]
    for part in parts:
        body = _FIRST.sub("", part) if len(parts) > 1 else part
        kept, gone = _affirmed(body)
        dropped += gone
        found = _SUBJECT.match(body.strip())
        if kept:
            steps.append(kept if found or not subject else _with_subject(subject, kept))
        subject = found.group("subject") if found else subject
    return Wording(tuple(steps) or (STAND_TEXT,), tuple(dropped))


def _affirmed(part: str) -> tuple[str, list[str]]:
    """What a step says to do (may be nothing), and the clauses that it denies."""
    plain = _NOT_ONLY.sub(r"\1 and ", part)
    plain = _NEVER_STOP.sub(_keep, plain)
    if not _NOT.search(plain):
        return plain.strip(), []
    phrase = _HEAD_PHRASE.match(plain)
    if phrase:
        rest, gone = _affirmed(phrase.group("rest"))
        return rest, [plain[: phrase.start("rest")].strip(" ,"), *gone]
    kept: list[str] = []
    dropped: list[str] = []
    subject = ""
    for joint, clause in _clauses(plain):
        found = _SUBJECT.match(clause.strip())
        subject = found.group("subject") if found and not subject else subject
        denied = _NOT.search(clause)
        said = clause if denied is None else _before(clause, denied)
        if denied is not None:
            dropped.append(clause[len(said) :].strip(" ,.;:!") if said else clause.strip(" ,.;:!"))
        if dropped:
            said = _LEADING.sub("", said.strip())
            said = _TRAILING.sub("", said)
        if _EMPTY.match(said):
            continue
        if not kept and dropped and subject and not _SUBJECT.match(said.strip()):
            said = _with_subject(subject, said.strip())
        kept.append(said if not kept else joint + said)
    return "".join(kept).strip(" ,;:"), dropped


def _clauses(text: str) -> list[tuple[str, str]]:
    """(what joins it to the one before, clause), in order. "And" parts only what a negation does not reach over."""
    pieces = _CLAUSE.split(text)
    out: list[tuple[str, str]] = []
    for joint, clause in zip(["", *pieces[1::2]], pieces[::2], strict=True):
        rest, before = clause, joint
        while rest.strip():
            cut = _OWN_CLAUSE.search(rest)
            denied = _NOT.search(rest)
            if denied is not None and _OF_ONE.match(denied.group(0)):
                other = _THIRD_PERSON.search(rest, denied.end())
                cut = min((c for c in (cut, other) if c is not None), key=lambda c: c.start(), default=None)
            if cut is None:
                out.append((before, rest))
                break
            out.append((before, rest[: cut.start()]))
            before, rest = cut.group(0), rest[cut.end() :]
    return out


def _before(clause: str, denied: re.Match[str]) -> str:
    """What a clause says before its negation, when that is more than who is spoken of."""
    said = _TRAILING.sub("", clause[: denied.start()])
    return "" if _EMPTY.match(said) else said


def _keep(found: re.Match[str]) -> str:
    third = re.search(r"does|doesn|has|is|will", found.group(0), re.IGNORECASE)
    return "keeps " if third or found.group("stop").lower().endswith("s") else "keep "


def _with_subject(subject: str, clause: str) -> str:
    first = clause.split()[0] if clause.split() else ""
    be = "are " if subject.lower() in ("they", "you") else "is "
    return f"{subject} {be if first.endswith('ing') else ''}{clause}"
