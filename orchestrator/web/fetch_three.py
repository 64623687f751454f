"""Fetch three.js for the page: `python -m orchestrator.web.fetch_three`.

The pinned version comes from its npm package through npm itself, so that a mirror or proxy set up for npm is used. The
package must have the checksum written here; the four files the page needs are copied to `orchestrator/web/vendor`.
"""

from __future__ import annotations

import base64
import hashlib
import json
import shutil
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

from orchestrator.web import VENDOR, missing_vendor_files
from shared.errors import MotionLoopError, UnavailableError

VERSION = "0.187.0"
SHA512 = "Qiu7R+Cmh8CstZsY1uJOSWnVlfo7ZtNLV7mF8Jltk3LB3AtDu9cRZlcnRKkAk8Y4z6KKw35z7Y7Urd7jWY8etA=="
WANTED = {
    "package/build/three.module.js": "three.module.js",
    "package/build/three.core.js": "three.core.js",
    "package/examples/jsm/controls/OrbitControls.js": "OrbitControls.js",
    "package/LICENSE": "LICENSE.three.txt",
}
NOTE = "version.json"
TIMEOUT_S = 300


def is_current(folder: Path = VENDOR) -> bool:
    """Whether the folder holds all files of the pinned version."""
    note = folder / NOTE
    if missing_vendor_files(folder) or not note.is_file():
        return False
    return bool(json.loads(note.read_text(encoding="utf-8")) == {"three": VERSION, "sha512": SHA512})


def pack_with_npm(folder: Path) -> Path:
    """Let npm put the package's tarball into a folder; raises UnavailableError saying what is missing."""
    npm = shutil.which("npm")
    if npm is None:
        raise UnavailableError("npm is not installed: on Debian or Ubuntu run: apt-get install npm")
    command = [npm, "pack", f"three@{VERSION}", "--silent", "--pack-destination", str(folder)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False, cwd=folder)
    except subprocess.TimeoutExpired as error:
        raise UnavailableError(f"npm did not fetch three@{VERSION} within {TIMEOUT_S} s") from error
    found = sorted(folder.glob("three-*.tgz"))
    if done.returncode or not found:
        raise UnavailableError(f"npm could not fetch three@{VERSION}: {done.stderr.strip()[-500:]}")
    return found[0]


def install(tarball: Path, folder: Path = VENDOR) -> None:
    """Check the tarball and copy the wanted files; raises UnavailableError when it is not the pinned package."""
    data = tarball.read_bytes()
    digest = base64.b64encode(hashlib.sha512(data).digest()).decode()
    if digest != SHA512:
        raise UnavailableError(f"three@{VERSION} has the checksum {digest}", field="sha512", allowed=SHA512)
    folder.mkdir(parents=True, exist_ok=True)
    with tarfile.open(tarball) as archive:
        for member, name in WANTED.items():
            file = archive.extractfile(member)
            if file is None:
                raise UnavailableError(f"three@{VERSION} has no {member}")
            text = file.read().decode("utf-8")
            # A page without an import map (its policy allows no inline script) names modules by their paths.
            (folder / name).write_text(text.replace("from 'three'", "from './three.module.js'"), encoding="utf-8")
    (folder / NOTE).write_text(json.dumps({"three": VERSION, "sha512": SHA512}) + "\n", encoding="utf-8")


def main() -> int:
    """Fetch what is not there; 1 with a line on stderr when that fails."""
    if is_current():
        (VENDOR / NOTE).touch()  # make compares dates
        return 0
    try:
        with tempfile.TemporaryDirectory() as folder:
            install(pack_with_npm(Path(folder)))
    except MotionLoopError as error:
        sys.stderr.write(f"the live page will not work: {error.message}\n")
        return 1
    sys.stdout.write(f"three.js {VERSION} for the live page\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
