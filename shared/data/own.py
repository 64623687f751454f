"""Anybody's folder of recordings: what each file is, by its text, its folder's name, its own name or its motion."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from shared.console import EXPECTED, as_ours
from shared.data.label import RUN_MPS, Label, airborne, jump_label, path_speed
from shared.data.pieces import Piece, Report, pieces_of
from shared.data.reading import DEGENERATE, row, travelled_m
from shared.data.retarget import calibrate, retarget
from shared.data.sources import Take, is_known
from shared.data.texts import BEHAVIOURS, SENTENCES, clean, sentences
from shared.motion.body import J, velocity
from shared.motion.io.files import find_motion_files
from shared.motion.io.options import ReadOptions
from shared.motion.io.raw import LeftOutError
from shared.motion.io.text import decode
from shared.protocol.rates import CORPUS_FPS

_SYNONYMS = {
    "idle": "stand", "jog": "run", "jogging": "run", "box": "punch", "boxing": "punch", "getup": "get_up",
    "standup": "get_up", "liedown": "lie_down", "laydown": "lie_down", "pickup": "pick_up", "hop": "jump",
}  # fmt: skip
_ACTIONS = {"walk": "auto", "run": "auto", "jump": "auto", "kick": "kick_any", "sit": "sit_any"}
"""Actions of behaviours that are not called as they are; `auto` is told by the motion."""

_LOW_M = 0.62
_ARMS_MPS = 0.45


def _forms(behaviour: str) -> set[str]:
    """The words a behaviour may be called by: walk, walks, walking; wave, waving; run, running; get up, getting up."""
    first, _, rest = behaviour.partition("_")
    verbs = {first, first + "s", first + "es", first + "ing", first[:-1] + "ing", first + first[-1] + "ing"}
    return {verb + rest for verb in verbs}


_WORDS = {form: behaviour for behaviour in BEHAVIOURS if behaviour != "other" for form in _forms(behaviour)} | _SYNONYMS


def behaviour_named(name: str) -> str:
    """The behaviour a file or folder is called after, '' where its name is none or says several."""
    words = [w for w in re.split(r"[^a-z]+", re.sub(r"([a-z])([A-Z])", r"\1 \2", name).lower()) if w]
    pairs = ["".join(pair) for pair in zip(words, words[1:], strict=False)]
    found = {_WORDS[w] for w in pairs if w in _WORDS} or {_WORDS[w] for w in words if w in _WORDS}
    return found.pop() if len(found) == 1 else ""


def own_takes(folder: Path, options: ReadOptions) -> list[Take]:
    """Takes of the files below a folder that belong to no known collection.

    The sentences of a take are the lines of a text file of its name beside it. Its behaviour is the name of the
    nearest folder that is one (walk, walks, walking), else its own name, else what its motion shows. Each file is
    calibrated by itself: a folder may hold many skeletons.
    """
    takes: list[Take] = []
    paths = [path for path in find_motion_files(folder) if not is_known(folder, path)]
    stems = Counter(str(path.with_suffix("")).casefold() for path in paths)
    for path in paths:
        inner = path.relative_to(folder)
        source = inner.parts[0] if len(inner.parts) > 1 else folder.resolve().name
        stem = "/".join((inner if len(inner.parts) == 1 else inner.relative_to(source)).with_suffix("").parts)
        if stems[str(path.with_suffix("")).casefold()] > 1:
            stem += f"_{path.suffix[1:]}"
        # In names of clips these signs part a take from its pieces.
        name = re.sub(r"[+@#~]", "_", f"{source}/{stem}")
        folders = [*reversed(inner.parts[:-1]), folder.resolve().name]
        behaviour = next((b for b in map(behaviour_named, folders) if b), "") or behaviour_named(path.stem)
        action = _ACTIONS.get(behaviour, behaviour if behaviour in SENTENCES else "auto")
        side = "auto" if behaviour in ("turn", "step_side") else ""
        # What is told by its motion is cut like locomotion and labelled afterwards, by `seen`.
        kind = behaviour or "walk"
        texts = _texts(path)
        takes.append(
            Take(name, source, path, None, name, kind, action, side, texts, options=options, by_motion=not behaviour)
        )
    return takes


def _texts(path: Path) -> tuple[str, ...]:
    """The lines of the text file beside a recording; an empty one says nothing."""
    beside = path.with_suffix(".txt")
    return tuple(clean(decode(beside.read_bytes()).splitlines())) if beside.is_file() else ()


def seen(pieces: Sequence[Piece], report: Report) -> list[Piece]:
    """Pieces of an unlabelled take, labelled by more than their locomotion: jumps and gestures are told, and what is
    low is left out, since standing, walking and turning are no words for it."""
    out = []
    for piece in pieces:
        p, label = piece.positions, piece.label
        if float(np.percentile(p[:, J["pelvis"], 2], 20)) < _LOW_M:
            report.drop(piece.name, "low on the floor and nothing says what it is: name its folder or give it a text")
            continue
        if airborne(p).sum() >= 3 and float(path_speed(p).mean()) < RUN_MPS:
            label = jump_label(p)
        elif label.behaviour == "stand":
            wrists = p[:, [J["left_wrist"], J["right_wrist"]]] - p[:, :1]
            if float(np.linalg.norm(velocity(wrists, CORPUS_FPS), axis=-1).mean(axis=0).max()) > _ARMS_MPS:
                label = Label("gesture", "gesture")
        if label != piece.label:
            before = set(clean(sentences(piece.label.action, piece.label.side)))
            kept = [text for text in piece.texts if text not in before]
            piece = replace(piece, label=label, texts=tuple(clean([*kept, *sentences(label.action, label.side)])))
        out.append(piece)
    return out


def own_pieces(takes: Sequence[Take], report: Report, progress: Callable[[str, float], None]) -> list[Piece]:
    """Labelled pieces of a person's own takes; a file that cannot be read is reported and does not end it."""
    out: list[Piece] = []
    for k, take in enumerate(takes):
        progress(f"read {take.name}", k / len(takes))
        before = len(report.left_out)
        try:
            raw = take.read()
            calibration = calibrate([raw])
            pieces = pieces_of(take, raw, calibration, report)
            way = travelled_m(retarget(raw, calibration))
        except LeftOutError as error:
            report.drop(take.name, str(error))
            report.lines.append(f"warning: {take.name}: left out: {error}")
            continue
        except (*EXPECTED, *DEGENERATE) as error:
            report.fail(take.name, as_ours(error).message if isinstance(error, EXPECTED) else f"no person ({error})")
            continue
        pieces = seen(pieces, report) if take.by_motion else pieces
        kinds = ", ".join(sorted({p.label.behaviour for p in pieces})) or "nothing"
        cells = row(take.name, raw.fps, len(raw) / raw.fps, raw.up, raw.unit_m, raw.family, way)
        report.lines.append(f"{cells}  -> {len(pieces)} clips: {kinds}")
        report.lines += [f"warning: {take.name}: {warning}" for warning in raw.warnings]
        dropped = report.left_out[before:]
        report.lines += [f"warning: {piece['clip']}: left out: {piece['reason']}" for piece in dropped]
        report.files.append(
            {"take": take.name, "file": str(take.path), "fps": raw.fps, "seconds": round(len(raw) / raw.fps, 3),
             "up": raw.up, "unit_m": raw.unit_m, "skeleton": raw.family, "travelled_m": round(way, 3),
             "clips": len(pieces), "warnings": list(raw.warnings)}
        )  # fmt: skip
        out += pieces
    return out
