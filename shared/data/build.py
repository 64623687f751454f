"""`motionloop data build`: from a folder of recordings to a training corpus."""

from __future__ import annotations

import hashlib
import tarfile
import tempfile
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from shared.console import EXPECTED, as_ours
from shared.data.corpus import FORMAT, ClipInfo, write_corpus
from shared.data.label import rotation_steps_rad
from shared.data.own import own_pieces, own_takes
from shared.data.pieces import Piece, Report, at_origin, pieces_of, same_recording
from shared.data.retarget import calibrate, retarget
from shared.data.sources import Take, list_takes
from shared.data.splice import local_rotations
from shared.data.texts import clean, swap_sides
from shared.errors import InvalidInputError
from shared.motion.body import Array, mirror
from shared.motion.io.options import ReadOptions
from shared.motion.io.raw import LeftOutError, RawMotion
from shared.motion.limbs import bends_rad
from shared.protocol.rates import CORPUS_FPS as FPS

Progress = Callable[[str, float], None]
"""Called with what is being done and the share of the whole that is finished, 0 to 1."""

HELDOUT_SHARE = 0.1
RARE_TAKES = 12
"""A behaviour with fewer takes is split by piece."""

BEHAVIOUR_SHARES = {
    "walk": 0.16, "run": 0.08, "turn": 0.08, "stand": 0.06, "wave": 0.08, "jump": 0.07, "punch": 0.055, "kick": 0.055,
    "squat": 0.03, "sneak": 0.02, "dance": 0.04, "gesture": 0.035, "get_up": 0.03, "lie_down": 0.02, "pick_up": 0.015,
    "throw": 0.015, "sit": 0.04, "rise": 0.03, "step_back": 0.03, "step_side": 0.03, "exercise": 0.015, "other": 0.02,
}  # fmt: skip
"""Share of training samples by behaviour: what a command can ask for comes first, whatever its minutes."""

_DUPLICATES_AMONG = ("cmu_subjects", "cmu_asfamc", "cmu_daily", "cmu_actions")


def quiet(stage: str, share: float) -> None:
    """Progress that shows nothing."""


def unpacked(folder: Path, stack: ExitStack) -> Path:
    """The folder itself, or a temporary one with its .tar.xz archives unpacked.

    Raises:
        InvalidInputError: no such folder, or an archive that cannot be read.
    """
    if not folder.is_dir():
        raise InvalidInputError(f"{folder} is not a folder", field="mocap_dir", allowed="a folder of recordings")
    archives = sorted(folder.glob("*.tar.xz"))
    if not archives:
        return folder
    # Loose files are named after their folder, so it has to be called as the one of the archives.
    scratch = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="motionloop-mocap-"))) / folder.resolve().name
    scratch.mkdir(exist_ok=True)
    for archive in archives:
        try:
            with tarfile.open(archive) as tar:
                tar.extractall(scratch, filter="data")
        except (tarfile.TarError, OSError) as error:
            raise InvalidInputError(f"{archive.name}: {error}", field="mocap_dir") from error
    return scratch


def check_place(mocap_dir: Path, out_dir: Path) -> None:
    """Make sure that a corpus may take the place of `out_dir`, which is replaced as a whole.

    Raises:
        InvalidInputError: it holds the recordings, or something that is no corpus.
        OSError: it cannot be made.
    """
    source, out = mocap_dir.resolve(), out_dir.resolve()
    if out == source or out in source.parents:
        raise InvalidInputError(f"{out_dir}: the corpus would take the place of the recordings", field="out_dir")
    out.parent.mkdir(parents=True, exist_ok=True)
    if out.is_file() or (out.is_dir() and any(out.iterdir()) and not (out / "manifest.json").is_file()):
        what = "it is a file" if out.is_file() else "it holds something that is no corpus"
        raise InvalidInputError(f"{out_dir}: {what}; give an empty or a new folder", field="out_dir")


def hash_inputs(folder: Path) -> str:
    """sha256 over names and contents of all files below a folder."""
    digest = hashlib.sha256()
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        digest.update(str(path.relative_to(folder)).encode())
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def recorded_pieces(takes: Sequence[Take], report: Report, progress: Progress) -> list[Piece]:
    """Pieces of all usable takes; repeated recordings are left out."""
    groups: dict[str, list[Take]] = defaultdict(list)
    for take in takes:
        if take.skip:
            report.drop(take.name, take.skip)
        else:
            groups[take.skeleton_key].append(take)
    pieces: list[Piece] = []
    bends: list[tuple[str, Array]] = []
    done, total = 0, sum(len(g) for g in groups.values())
    # Sources whose file names tell the trial come first, so that of two copies the better described one stays.
    order = sorted(groups, key=lambda k: (k.split("/")[0] == "cmu_actions", k.split("/")[0] == "cmu_asfamc", k))
    for key in order:
        raws: list[tuple[Take, RawMotion]] = []
        for take in groups[key]:
            try:
                raws.append((take, take.read()))
            except LeftOutError as error:
                report.drop(take.name, error.message)
            except EXPECTED as error:
                report.fail(take.name, as_ours(error).message)
        if not raws:
            continue
        calibration = calibrate([raw for _, raw in raws])
        for take, raw in raws:
            if take.source in _DUPLICATES_AMONG:
                own = np.stack(list(bends_rad(retarget(raw, calibration)[1:]).values()), axis=-1)
                twin = next((name for name, other in bends if same_recording(own, other)), "")
                if twin:
                    report.drop(take.name, f"the same recording as {twin}")
                    continue
                bends.append((take.name, own))
            pieces += pieces_of(take, raw, calibration, report)
            done += 1
            progress(f"retarget {key}", 0.6 * done / total)
    return pieces


def heldout_pieces(pieces: Sequence[Piece]) -> set[str]:
    """Names of about a tenth of the pieces of each behaviour, by the hash of the names of their takes.

    Of a behaviour with fewer takes than RARE_TAKES single pieces are held out, so that each has held-out clips; others
    are split by take, and whatever comes from a held-out take is held out.
    """
    frames: dict[str, dict[str, int]] = defaultdict(lambda: defaultdict(int))
    for piece in pieces:
        frames[piece.take][piece.label.behaviour] += len(piece.positions)
    kind = {take: max(shares, key=lambda b: shares[b]) for take, shares in frames.items()}
    takes: dict[str, set[str]] = defaultdict(set)
    for take, behaviour in kind.items():
        takes[behaviour].add(take)
    common = {b for b, names in takes.items() if len(names) >= RARE_TAKES}
    held = {t for b in common for t in _tenth(takes[b])}
    out = {p.name for p in pieces if held & set(p.take.split("+"))}
    for behaviour in {p.label.behaviour for p in pieces} - common:
        own = [p.name for p in pieces if p.label.behaviour == behaviour]
        if not out.intersection(own):
            out.update(_tenth(own))
    return out


def _tenth(names: Iterable[str]) -> list[str]:
    """About a tenth of the names, by their hash; at least one of four or more."""
    order = sorted(set(names), key=lambda n: hashlib.sha256(n.encode()).hexdigest())
    return order[: max(round(HELDOUT_SHARE * len(order)), 1 if len(order) >= 4 else 0)]


def with_split(pieces: Sequence[Piece], heldout: set[str]) -> list[Piece]:
    """Pieces marked by name; a take with pieces on both sides is named by its pieces from here on."""
    sides: dict[str, set[bool]] = defaultdict(set)
    for p in pieces:
        sides[p.take].add(p.name in heldout)
    out = [replace(p, split="heldout" if p.name in heldout else "train") for p in pieces]
    return [replace(p, take=p.name) if len(sides[p.take]) > 1 else p for p in out]


def weights(pieces: Sequence[Piece]) -> list[float]:
    """Weight of each piece: its behaviour's share times its part of the behaviour's frames; zero if held out."""
    total: dict[str, int] = defaultdict(int)
    for p in pieces:
        if p.split == "train":
            total[p.label.behaviour] += len(p.positions)
    norm = sum(BEHAVIOUR_SHARES[b] for b in total)
    return [
        BEHAVIOUR_SHARES[p.label.behaviour] / norm * len(p.positions) / total[p.label.behaviour]
        if p.split == "train"
        else 0.0
        for p in pieces
    ]


def mirrored(piece: Piece) -> Piece:
    """The piece with left and right exchanged, in its words too."""
    side = swap_sides(piece.label.side)
    other = replace(
        piece,
        name=piece.name + "~mirror",
        label=replace(piece.label, side=side),
        texts=tuple(clean(swap_sides(t) for t in piece.texts)),
        positions=mirror(piece.positions),
        seat=piece.seat.mirrored() if piece.seat else None,
        strike=piece.strike.mirrored() if piece.strike else None,
    )
    return at_origin(other)


def _minutes(pieces: Sequence[Piece], key: Callable[[Piece], str]) -> dict[str, dict[str, float]]:
    out: dict[str, dict[str, float]] = defaultdict(lambda: {"train": 0.0, "heldout": 0.0, "made": 0.0})
    for p in pieces:
        minutes = len(p.positions) / FPS / 60
        out[key(p)][p.split] += minutes
        if p.made:
            out[key(p)]["made"] += minutes
    return {k: {n: round(m, 3) for n, m in v.items()} for k, v in sorted(out.items())}


def quality_summary(pieces: Sequence[Piece]) -> dict[str, Any]:
    """Mean quality figures of recorded and of made pieces, and the change of rotations per tick."""
    out: dict[str, Any] = {}
    for name, made in (("recorded", False), ("made", True)):
        values = [p.quality.as_dict() for p in pieces if p.made == made and p.quality is not None]
        if values:
            out[name] = {k: round(float(np.mean([v[k] for v in values])), 4) for k in values[0]}
            out[name]["bone_error_mm"] = round(max(v["bone_error_mm"] for v in values), 6)
    if pieces:
        steps = np.concatenate([rotation_steps_rad(local_rotations(p.positions)).max(axis=1) for p in pieces])
        moves = np.concatenate([np.linalg.norm(np.diff(p.positions, axis=0), axis=-1).max(axis=1) for p in pieces])
        for key, x in (("rotation_step_rad", steps), ("position_step_m", moves)):
            out[key] = {f"p{q}": round(float(np.percentile(x, q)), 4) for q in (50, 95, 99, 99.9, 100)}
    return out


def build(
    mocap_dir: str | Path,
    out_dir: str | Path,
    seed: int = 0,
    progress: Progress = quiet,
    command: str = "",
    amount: float = 1.0,
    options: ReadOptions | None = None,
    say: Callable[[str], None] = lambda line: None,
) -> dict[str, Any]:
    """Build the corpus.

    Args:
        mocap_dir: folder with one folder per source, or with their .tar.xz archives; or any folder of recordings, see
            `shared.data.own`.
        out_dir: corpus folder, replaced as a whole.
        seed: of everything random in made motion; the split does not depend on it.
        progress: told what is being done.
        command: command line for the manifest.
        amount: scales how many pieces of each kind are made.
        options: what files of no known collection do not say.
        say: told how each of those was read, and which could not be.

    Returns:
        The manifest; `errors` are the files that could not be read.

    Raises:
        InvalidInputError: no recordings there, none that can be used, or a folder `out_dir` that holds something else.
    """
    from shared.data.make import made_pieces  # the makers build on this module's helpers

    check_place(Path(mocap_dir), Path(out_dir))
    report = Report()
    with ExitStack() as stack:
        folder = unpacked(Path(mocap_dir), stack)
        progress("hash", 0.0)
        digest = hash_inputs(folder)
        # Recordings may lie beside the archives; of one in both, the archive's stays.
        places = dict.fromkeys((Path(mocap_dir), folder))
        takes = list({take.name: take for place in places for take in list_takes(place, folder / "text")}.values())
        own = [take for place in places for take in own_takes(place, options or ReadOptions())]
        if not takes and not own:
            raise InvalidInputError(f"no BVH, AMC or npz below {mocap_dir}", field="mocap_dir")
        pieces = recorded_pieces(takes, report, progress)
        pieces += own_pieces(own, report, lambda what, share: progress(what, 0.6 if takes else 0.6 * share))
    for line in report.lines:
        say(line)
    if not pieces:
        why = "; ".join(f"{row['clip']}: {row['reason']}" for row in report.left_out[:3])
        raise InvalidInputError(f"no clip below {mocap_dir} can be used: {why}", field="mocap_dir")
    pieces = with_split(pieces, heldout_pieces(pieces))
    pieces += made_pieces(pieces, np.random.default_rng(seed), report, progress, amount)
    clips: list[tuple[Piece, bool]] = [(p, False) for p in pieces]
    clips += [(mirrored(p), True) for p in pieces if p.split == "train"]
    share = weights([p for p, _ in clips])
    progress("quality", 0.95)
    manifest: dict[str, Any] = {
        "format": FORMAT,
        "command": command or f"shared.data.build.build({str(mocap_dir)!r}, {str(out_dir)!r}, seed={seed})",
        "seed": seed,
        "fps": FPS,
        "skeleton": "human22",
        "input_sha256": digest,
        "clips": len(clips),
        "minutes": round(sum(len(p.positions) for p, _ in clips) / FPS / 60, 2),
        "minutes_unmirrored": round(sum(len(p.positions) for p in pieces) / FPS / 60, 2),
        "minutes_by_behaviour_unmirrored": _minutes(pieces, lambda p: p.label.behaviour),
        "minutes_by_source_unmirrored": _minutes(pieces, lambda p: p.source),
        "quality": quality_summary(pieces),
        "heldout_takes": sorted({p.take for p in pieces if p.split == "heldout" and not p.made}),
        "left_out": report.left_out,
        "errors": report.errors,
        "files": report.files,
    }
    infos = [
        ClipInfo(
            name=p.name,
            take=p.take,
            source=p.source,
            behaviour=p.label.behaviour,
            action=p.label.action,
            texts=p.texts,
            split=p.split,
            made=p.made,
            mirrored=m,
            start=0,
            frames=0,
            weight=w,
            seat=p.seat,
            strike=p.strike,
        )
        for (p, m), w in zip(clips, share, strict=True)
    ]
    write_corpus(out_dir, [(i, p.positions) for i, (p, _) in zip(infos, clips, strict=True)], manifest)
    progress("done", 1.0)
    return manifest
