"""The command `motionloop`."""

from __future__ import annotations

import sys


def main() -> None:
    """Entry point. Ctrl-C while it is still loading ends it as quietly as later on."""
    try:
        from orchestrator.cli.main import main as run

        run()
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    main()
