"""The corpus that evaluations build once and keep, for those who name none."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

from shared.data.build import Progress, build, hash_inputs, quiet
from shared.data.corpus import Corpus
from shared.errors import InvalidInputError

BESIDE_CHECKOUT = Path(__file__).resolve().parents[2].parent / "shared" / "mocap"


def mocap_folder() -> Path | None:
    """Folder of recorded motion: MOTIONLOOP_MOCAP, else `shared/mocap` beside the checkout; None where there is none
    of them."""
    named = os.environ.get("MOTIONLOOP_MOCAP")
    folder = Path(named) if named else BESIDE_CHECKOUT
    return folder if folder.is_dir() else None


def cached_corpus(progress: Progress = quiet) -> Corpus:
    """The corpus of `mocap_folder`, from the user's cache, built there first if need be (minutes).

    Raises:
        InvalidInputError: there is no recorded motion.
    """
    folder = mocap_folder()
    if folder is None:
        raise InvalidInputError(
            f"no recorded motion at {BESIDE_CHECKOUT}",
            field="corpus",
            allowed="--corpus FOLDER, or MOTIONLOOP_MOCAP set to a folder of recordings",
        )
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "motionloop"
    # The code decides what is made of the recordings as much as they do.
    target = cache / f"corpus_{hash_inputs(folder)[:12]}_{_code_version()}"
    if not (target / "manifest.json").exists():
        cache.mkdir(parents=True, exist_ok=True)
        build(folder, target, progress=progress)
    return Corpus.load(target)


def _code_version() -> str:
    """Of what makes motion: this package, and `shared.motion` that it stands on."""
    digest = hashlib.sha256()
    here = Path(__file__).parent
    for path in sorted([*here.rglob("*"), *(here.parent / "motion").rglob("*")]):
        if path.suffix in (".py", ".yaml"):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:12]
