"""Make CURVE keys: `python -m shared.protocol.keys FOLDER` (then set MOTIONLOOP_CURVE_DIR to it on every machine).

With `--client OTHER` the services' keys go to FOLDER and the clients' to OTHER; neither holds the other's secret.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from shared.protocol.security import create_curve_keys, move_client_keys


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--client", type=Path, metavar="OTHER", help="folder for the clients' keys")
    given = parser.parse_args()
    folder: Path = given.folder
    other: Path | None = given.client
    create_curve_keys(folder)
    if other is not None:
        move_client_keys(folder, other)
    print(f"keys for services are in {folder}, for clients in {other or folder}; keep *.key_secret to yourself")


if __name__ == "__main__":
    main()
