"""Chromium for the tests of the page: `python -m tests.page.browser` finds it, or installs it with apt-get."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

NAMES = ("chromium", "chromium-browser", "google-chrome-stable", "google-chrome")
INSTALL = ("apt-get", "install", "-y", "-qq", "--no-install-recommends", "chromium", "fonts-liberation")

# No graphics card is asked for: WebGL is drawn by SwiftShader. The sandbox cannot be set up as root.
ARGUMENTS = (
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--disable-dev-shm-usage",
    "--disable-background-networking",
    "--disable-component-update",
    "--no-first-run",
)


def find() -> str | None:
    """Path of a Chromium: the one named by MOTIONLOOP_CHROMIUM, or the first that is installed."""
    named = os.environ.get("MOTIONLOOP_CHROMIUM")
    if named:
        return named if Path(named).is_file() else None
    return next((path for name in NAMES if (path := shutil.which(name)) is not None), None)


def main() -> int:
    """0 when a browser is there, if need be by installing one."""
    if find() is None and shutil.which("apt-get") and os.geteuid() == 0:
        sys.stdout.write("installing chromium (about a minute) ...\n")
        subprocess.run(["apt-get", "update", "-qq"], check=False)
        quiet = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
        subprocess.run(INSTALL, check=False, env=quiet, stdout=subprocess.DEVNULL)
    path = find()
    if path is None:
        sys.stderr.write("no Chromium: install it (apt-get install chromium) or set MOTIONLOOP_CHROMIUM to its path\n")
        return 1
    sys.stdout.write(f"browser: {path}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
