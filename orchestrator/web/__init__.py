"""The live page: plain ES modules in `static`, three.js in `vendor` (put there by `make setup`)."""

from __future__ import annotations

from pathlib import Path

STATIC = Path(__file__).resolve().parent / "static"
VENDOR = Path(__file__).resolve().parent / "vendor"

VENDOR_FILES = ("three.module.js", "three.core.js", "OrbitControls.js", "LICENSE.three.txt")


def missing_vendor_files(folder: Path = VENDOR) -> tuple[str, ...]:
    """Names of the files of three.js that are not there."""
    return tuple(name for name in VENDOR_FILES if not (folder / name).is_file())
