"""Motion files of any kind: which there are in a folder, and how each is read."""

from __future__ import annotations

from pathlib import Path

from shared.errors import InvalidInputError
from shared.motion.io.asfamc import read_asf_amc
from shared.motion.io.bvh import read_bvh
from shared.motion.io.options import ReadOptions
from shared.motion.io.raw import RawMotion
from shared.motion.io.smpl import is_own_clip, read_smpl_npz

SUFFIXES = (".bvh", ".amc", ".npz")


def motion_files(path: Path, but_not: Path | None = None) -> list[Path]:
    """The file itself, or all motion files below a folder in a stable order; hidden ones are passed over.

    Args:
        but_not: a folder for results: what lies in it does not count, or, where the recordings lie in it too, what
            was imported into it.

    Raises:
        InvalidInputError: there are none.
    """
    found = [path] if path.is_file() else find_motion_files(path, but_not)
    if not found:
        raise InvalidInputError(f"no motion files at {path}", field="path", allowed=", ".join(SUFFIXES))
    return found


def find_motion_files(path: Path, but_not: Path | None = None) -> list[Path]:
    """Motion files below a folder as of `motion_files`, none where there are none."""
    found = [
        p
        for p in sorted(path.rglob("*"))
        if p.suffix.lower() in SUFFIXES
        and (p.is_file() or (p.is_symlink() and not p.exists()))
        and not any(part.startswith(".") or part == "__MACOSX" for part in p.relative_to(path).parts)
    ]
    apart = but_not.resolve() if but_not is not None else None
    if apart is not None and path.resolve() in apart.parents:
        found = [p for p in found if apart not in p.resolve().parents]
    own = {p for p in found if p.suffix == ".npz" and is_own_clip(p)}
    # An imported clip lies there twice, as npz and as BVH: one is enough.
    found = [p for p in found if not (p in own and p.with_suffix(".bvh") in found)]
    return [p for p in found if not (p.with_suffix(".npz") in own and p.resolve().parent == apart)]


def find_skeleton(amc: Path) -> Path:
    """The ASF in an AMC's folder whose name begins the AMC's name (the longest such), or the only one there.

    Raises:
        InvalidInputError: there is none, or several that do not match.
    """
    skeletons = sorted(p for p in amc.parent.iterdir() if p.suffix.lower() == ".asf")
    named = [s for s in skeletons if amc.stem.lower().startswith(s.stem.lower())]
    if not named and len(skeletons) != 1:
        there = f"; there are {', '.join(s.name for s in skeletons[:6])}" if skeletons else ""
        raise InvalidInputError(f"{amc.name}: no ASF skeleton for it in its folder{there}", field="path")
    return max(named or skeletons, key=lambda s: len(s.stem))


def read_motion(path: str | Path, options: ReadOptions | None = None) -> RawMotion:
    """Read a BVH, an AMC (with its ASF beside it) or an SMPL npz.

    Args:
        path: motion file; upper and lower case of its suffix are the same.
        options: what the file does not say.

    Raises:
        InvalidInputError: unknown type, no skeleton, or a file that cannot be read; the message names it.
    """
    path = Path(path)
    options = options or ReadOptions()
    suffix = path.suffix.lower()
    if not path.is_file():
        gone = "a link to a file that is not there" if path.is_symlink() else "not a file"
        raise InvalidInputError(f"{path.name}: {gone}", field="path")
    if suffix == ".bvh":
        return read_bvh(path, options.up, options.unit_m, options.fps, options.joints, options.root)
    if suffix == ".npz":
        return read_smpl_npz(path, options.up, options.unit_m, options.fps)
    if suffix == ".amc":
        return read_asf_amc(find_skeleton(path), path, options.fps, options.unit_m, options.up, options.joints)
    if suffix == ".asf":
        raise InvalidInputError(f"{path.name}: a skeleton without motion; give its AMC", field="path")
    raise InvalidInputError(f"{path.name}: not one of the types that are read: {', '.join(SUFFIXES)}", field="path")
