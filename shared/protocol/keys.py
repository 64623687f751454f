"""Make CURVE keys: `python -m shared.protocol.keys FOLDER` (then set MOTIONLOOP_CURVE_DIR to it on every machine)."""

from __future__ import annotations

import argparse
from pathlib import Path

from shared.protocol.security import create_curve_keys


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    folder: Path = parser.parse_args().folder
    create_curve_keys(folder)
    print(f"keys for services (server) and their clients (client) are in {folder}; keep *.key_secret to yourself")


if __name__ == "__main__":
    main()
